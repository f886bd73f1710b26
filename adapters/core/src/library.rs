//! Where a vendor's library is looked for at run time, and what is said when it is not there.
//!
//! Nothing is loaded here: that is the device crate's business, in its one file of foreign functions.

use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};

/// A library that could not be loaded: what was tried, and what to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LibraryMissing {
    /// Name of the library, for example `libk4a`.
    pub library: &'static str,
    /// Each place that was tried, with the loader's words.
    pub tried: Vec<(PathBuf, String)>,
    /// What to do about it.
    pub remedy: String,
}

impl fmt::Display for LibraryMissing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} could not be loaded", self.library)?;
        for (place, why) in &self.tried {
            write!(f, "; {}: {why}", place.display())?;
        }
        write!(f, "; {}", self.remedy)
    }
}

impl std::error::Error for LibraryMissing {}

/// The places in their order. What a person named, in the settings or else in the environment, is the only one: it would not
/// do to load another library than the one that was meant. A folder stands for the library names in it.
pub fn places(
    configured: Option<&Path>,
    environment: Option<OsString>,
    names: &[&str],
    folders: &[&str],
) -> Vec<PathBuf> {
    let environment = environment.filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(named) = configured.map(Path::to_path_buf).or(environment) {
        if named.is_dir() {
            return names.iter().map(|name| named.join(name)).collect();
        }
        return vec![named];
    }
    let bare = names.iter().map(PathBuf::from);
    let inside = folders.iter().flat_map(|folder| names.iter().map(move |name| Path::new(folder).join(name)));
    bare.chain(inside).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: [&str; 2] = ["libx.so.1.4", "libx.so"];

    #[test]
    fn what_a_person_named_is_the_only_place() {
        let named = places(Some(Path::new("/opt/x.so")), Some("/env/x.so".into()), &NAMES, &["/usr/lib/x"]);
        assert_eq!(named, [PathBuf::from("/opt/x.so")]);
        let environment = places(None, Some("/env/x.so".into()), &NAMES, &[]);
        assert_eq!(environment, [PathBuf::from("/env/x.so")]);
        let folder = std::env::temp_dir();
        assert_eq!(places(Some(&folder), None, &NAMES, &[]), NAMES.map(|name| folder.join(name)));
    }

    #[test]
    fn else_the_loader_is_asked_first_and_known_folders_after() {
        let all = places(None, Some(OsString::new()), &NAMES, &["/usr/lib/x"]);
        let expected = ["libx.so.1.4", "libx.so", "/usr/lib/x/libx.so.1.4", "/usr/lib/x/libx.so"];
        assert_eq!(all, expected.map(PathBuf::from));
    }

    #[test]
    fn the_error_names_every_place_and_the_remedy() {
        let error = LibraryMissing {
            library: "libx",
            tried: vec![("/a/libx.so".into(), "not there".into())],
            remedy: "install it".into(),
        };
        assert_eq!(error.to_string(), "libx could not be loaded; /a/libx.so: not there; install it");
    }
}
