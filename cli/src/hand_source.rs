//! Where a hand comes from: the library by id, or a folder with `hand.urdf` and `hand.toml`.

use std::path::Path;

use anyhow::{Context as _, bail};
use graspd_hands::{Hand, HandError, HandFiles, library};

/// A hand by library id, or by the path of its folder.
///
/// # Errors
/// For an unknown id, with the nearest one; for a folder that does not make a hand, with every problem.
pub(crate) fn resolve(name: &str) -> anyhow::Result<Hand> {
    if let Some(hand) = library::hand(name) {
        return Ok(hand.clone());
    }
    let path = Path::new(name);
    if path.is_dir() {
        return from_folder(path);
    }
    if path.exists() {
        bail!("hand {name:?}: found a file, expected a folder with hand.urdf and hand.toml, or an id");
    }
    if name.contains(std::path::MAIN_SEPARATOR) {
        bail!("hand {name:?}: there is no such folder");
    }
    bail!("hand {name:?}: {}", unknown(name, library::ids()))
}

/// A hand from its folder; the folder's name becomes its id where that is one.
pub(crate) fn from_folder(path: &Path) -> anyhow::Result<Hand> {
    let files = graspd_server::read_hand_dir(path)?;
    Hand::load(&id_of(path), &files).with_context(|| format!("{}", path.display()))
}

/// The id that a folder's or file's name suggests.
pub(crate) fn id_of(path: &Path) -> String {
    let full = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let stem = full.file_stem().map(|s| s.to_string_lossy().to_lowercase()).unwrap_or_default();
    let id: String = stem.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).take(63).collect();
    let id = id.trim_matches('-').to_owned();
    if id.starts_with(|c: char| c.is_ascii_lowercase()) {
        id
    } else {
        format!("hand-{id}").trim_matches('-').to_owned()
    }
}

/// What to say about a folder whose name a server's folder of hands may not hold.
pub(crate) fn folder_warning(folder: &Path) -> Option<String> {
    let full = folder.canonicalize().ok()?;
    let name = full.file_name()?.to_string_lossy();
    // Without files only the id is looked at.
    match Hand::load(&name, &HandFiles::default()) {
        Err(error @ HandError::BadId { .. }) => Some(format!(
            "folder name as {error}; `graspd serve --hands-dir` refuses it (checked here as {:?})",
            id_of(folder)
        )),
        _ => None,
    }
}

/// What to say about an id that nobody knows.
pub(crate) fn unknown(name: &str, known: &[&str]) -> String {
    let nearest = known.iter().min_by_key(|id| distance(name, id));
    let list = known.join(", ");
    match nearest {
        Some(id) if distance(name, id) <= (name.chars().count() / 2).max(2) || id.contains(name) => {
            format!("no hand of that id and no folder; did you mean {id:?}? Known: {list}")
        }
        _ => format!("no hand of that id and no folder; known: {list}"),
    }
}

/// Levenshtein distance without regard to case, `-` or `_`.
fn distance(a: &str, b: &str) -> usize {
    let plain = |s: &str| s.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect::<Vec<char>>();
    let (a, b) = (plain(a), plain(b));
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let change = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = change.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_id_is_suggested() {
        let known = ["leap", "robotiq-2f85", "robotiq-3f", "brunel"];
        assert!(unknown("robotiq_3F", &known).contains("did you mean \"robotiq-3f\"?"));
        assert!(unknown("leep", &known).contains("did you mean \"leap\"?"));
        assert!(!unknown("shadow-dexterous", &known).contains("did you mean"));
    }

    #[test]
    fn what_looks_like_a_path_is_no_id() {
        let missing = resolve("./leep").unwrap_err().to_string();
        assert_eq!(missing, "hand \"./leep\": there is no such folder");
        let file = resolve("Cargo.toml").unwrap_err().to_string();
        assert!(file.contains("found a file, expected a folder"), "{file}");
    }

    #[test]
    fn ids_come_from_names() {
        assert_eq!(id_of(Path::new("/x/My Hand_2")), "my-hand-2");
        assert_eq!(id_of(Path::new("/x/3finger.urdf")), "hand-3finger");
        assert_eq!(distance("kitten", "sitting"), 3);
    }

    #[test]
    fn folder_names_that_a_server_refuses_are_told() {
        let base = std::env::temp_dir().join(format!("graspd-names-{}", std::process::id()));
        for (name, refused) in [("my-hand", false), ("Bad Name", true), ("9", true), ("ends-", false)] {
            std::fs::create_dir_all(base.join(name)).unwrap();
            let warning = folder_warning(&base.join(name));
            assert_eq!(warning.is_some(), refused, "{name}: {warning:?}");
            if let Some(text) = warning {
                assert!(text.contains(name) && text.contains("expected a lower-case letter"), "{text}");
            }
        }
        std::fs::remove_dir_all(&base).unwrap();
    }

    #[test]
    fn an_unknown_hand_is_an_error_that_lists_the_known_ones() {
        let message = resolve("no-such-gripper-at-all").unwrap_err().to_string();
        assert!(message.contains("known: ") && message.contains("leap"), "{message}");
    }
}
