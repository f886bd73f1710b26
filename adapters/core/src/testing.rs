//! What the tests of device crates share (feature `testing`): a stand-in of a vendor's library, built with the C compiler, and
//! the worked examples of the documentation.
//!
//! Made for tests: what goes wrong here panics, with what it was.
#![allow(clippy::expect_used, clippy::panic, reason = "a test that cannot be set up fails")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// Libraries that this process has built, by their source; `None` without a C compiler.
static BUILT: Mutex<BTreeMap<PathBuf, Option<PathBuf>>> = Mutex::new(BTreeMap::new());

/// Builds a C file into a shared library in `folder`, once in a process; `None`, and a line that says so, without a C
/// compiler.
///
/// # Panics
/// For a source that does not compile.
pub fn built(source: &Path, folder: &Path) -> Option<PathBuf> {
    let mut all = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    let build = || {
        let name = source.file_stem().and_then(|stem| stem.to_str()).unwrap_or("library");
        let out = folder.join(format!("{name}-{}.so", std::process::id()));
        let compiler = Command::new("cc")
            .args(["-shared", "-fPIC", "-O1", "-Wall", "-o"])
            .args([&out, source])
            .arg("-lpthread")
            .status();
        match compiler {
            Ok(status) => {
                assert!(status.success(), "{} does not compile", source.display());
                Some(out)
            }
            Err(error) => {
                eprintln!("SKIPPED: no C compiler to build the stand-in library with: {error}");
                None
            }
        }
    };
    all.entry(source.to_owned()).or_insert_with(build).clone()
}

/// A stand-in of one test's own: a copy of the library, which keeps its own state, reads its orders from the file
/// `control` beside it and tells what was done in `report`. The files go with it.
#[derive(Debug)]
pub struct StandIn {
    path: PathBuf,
}

impl StandIn {
    /// A copy named after the test; `None` without a C compiler.
    ///
    /// # Panics
    /// For a source that does not compile, and files that cannot be written.
    pub fn new(source: &Path, folder: &Path, library: &str, test: &str) -> Option<Self> {
        let built = built(source, folder)?;
        let path = built.with_file_name(format!("{library}-{test}-{}.so", std::process::id()));
        std::fs::copy(built, &path).expect("a copy of the library");
        let stand_in = Self { path };
        stand_in.control("");
        Some(stand_in)
    }

    /// The library.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A file beside it.
    pub fn beside(&self, ending: &str) -> PathBuf {
        PathBuf::from(format!("{}.{ending}", self.path.display()))
    }

    /// Gives orders; in one step, for the library may read them at any time.
    ///
    /// # Panics
    /// For a file that cannot be written.
    pub fn control(&self, text: &str) {
        let new = self.beside("new");
        std::fs::write(&new, text).expect("orders for the library");
        std::fs::rename(new, self.beside("control")).expect("orders for the library");
    }

    /// What the library has told.
    ///
    /// # Panics
    /// When it has told nothing yet.
    pub fn report(&self) -> String {
        std::fs::read_to_string(self.beside("report")).expect("a report of the library")
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        for path in [self.path.clone(), self.beside("json"), self.beside("control"), self.beside("report")] {
            // What was never there need not go.
            let _gone = std::fs::remove_file(path);
        }
    }
}

/// Hands every `toml` example of a page of documentation that has a `[camera]` to `take`: its table under
/// `camera.settings.KIND`, if any, and its address. Gives how many there were.
///
/// # Panics
/// For an example that is no TOML, has no camera, or one of another kind.
pub fn camera_examples(page: &str, kind: &str, mut take: impl FnMut(Option<toml::Value>, &str)) -> usize {
    let mut found = 0;
    for block in page.split("```toml\n").skip(1) {
        let (text, _) = block.split_once("```").expect("an example that ends");
        let file: toml::Table = text.parse().unwrap_or_else(|error| panic!("{error}: {text}"));
        let camera = file.get("camera").and_then(toml::Value::as_table).expect("an example with a camera");
        assert_eq!(camera.get("kind").and_then(toml::Value::as_str), Some(kind), "{text}");
        let table = camera.get("settings").and_then(|settings| settings.get(kind)).cloned();
        take(table, camera.get("address").and_then(toml::Value::as_str).unwrap_or_default());
        found += 1;
    }
    found
}
