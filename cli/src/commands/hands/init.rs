//! `graspd hands init`: the folder of a new hand, from its URDF.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Component, Path, PathBuf};

use anyhow::Context as _;
use graspd_hands::{HandFiles, propose};

use crate::hand_source;
use crate::input;

/// Reads a URDF and the meshes that it names, and writes a folder with them and a proposed `hand.toml`.
///
/// # Errors
/// If the URDF cannot be read, if nothing sensible can be derived from it, or if the folder has a description already.
pub(super) fn run(urdf: &Path, folder: Option<&Path>, out: &mut impl Write) -> anyhow::Result<()> {
    let bytes = input::read(urdf)?;
    let text = String::from_utf8(bytes)
        .with_context(|| format!("{}: not UTF-8, expected a URDF", urdf.display()))?;
    let folder = match folder {
        Some(folder) => folder.to_owned(),
        None => PathBuf::from(hand_source::id_of(urdf)),
    };
    anyhow::ensure!(
        !folder.join("hand.toml").exists(),
        "{}: exists already; choose another folder with --out",
        folder.join("hand.toml").display()
    );
    let base = urdf.parent().unwrap_or_else(|| Path::new("."));
    let mut files = HandFiles::default();
    for name in mesh_names(&text) {
        match find_mesh(base, &name) {
            Some(path) => {
                files.files.insert(name, input::read(&path)?);
            }
            None => writeln!(out, "mesh {name}: not found beside the URDF; its shape is missing")?,
        }
    }
    let toml = propose(&text, &files).with_context(|| format!("{}", urdf.display()))?;
    files.files.extend(HandFiles::new(text, toml.as_str()).files);
    for (name, contents) in &files.files {
        let path = folder.join(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent)
                .with_context(|| format!("{}: cannot be created", parent.display()))?;
        }
        std::fs::write(&path, contents).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    write!(out, "{toml}")?;
    writeln!(
        out,
        "\nwritten to {0}: read hand.toml, correct it, then run `graspd hands check {0}`",
        folder.display()
    )?;
    Ok(())
}

/// The mesh files that a URDF names, as paths in the hand's folder (`package://name/rest` is `rest`).
fn mesh_names(urdf: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for (at, _) in urdf.match_indices("filename") {
        let rest = urdf[at + "filename".len()..].trim_start();
        let Some(rest) = rest.strip_prefix('=').map(str::trim_start) else { continue };
        let Some(quote) = rest.chars().next().filter(|c| matches!(c, '"' | '\'')) else { continue };
        let Some(name) = rest[1..].split(quote).next() else { continue };
        let name = match name.strip_prefix("package://") {
            Some(rest) => rest.split_once('/').map_or("", |(_, path)| path),
            None => name,
        };
        let inside =
            Path::new(name).components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        if !name.is_empty() && inside {
            names.insert(name.trim_start_matches("./").to_owned());
        }
    }
    names
}

/// A mesh beside the URDF, or beside a folder above it: packages keep URDFs in a folder of their own.
fn find_mesh(base: &Path, name: &str) -> Option<PathBuf> {
    base.ancestors().take(4).map(|folder| folder.join(name)).find(|path| path.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_hands::library;

    #[test]
    fn mesh_names_stay_in_the_folder() {
        let urdf = r#"<mesh filename="package://my_hand/meshes/palm.stl"/><mesh filename = './tip.obj' />
            <mesh filename="../../etc/passwd"/><mesh filename="/abs.stl"/><mesh filename="#;
        let names: Vec<String> = mesh_names(urdf).into_iter().collect();
        assert_eq!(names, ["meshes/palm.stl", "tip.obj"]);
    }

    #[test]
    fn a_library_urdf_becomes_a_folder_that_checks() {
        let files = library::files("robotiq-2f85").unwrap();
        let folder = std::env::temp_dir().join(format!("graspd-init-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let urdf = folder.join("my_gripper.urdf");
        std::fs::write(&urdf, &files.files["hand.urdf"]).unwrap();
        let out = folder.join("made");
        let mut said = Vec::new();
        run(&urdf, Some(&out), &mut said).unwrap();
        let hand = hand_source::from_folder(&out).unwrap();
        assert_eq!(hand.fingers.len(), 2);
        let again = run(&urdf, Some(&out), &mut said).unwrap_err().to_string();
        assert!(again.contains("exists already"), "{again}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
