//! Where a vendor's library is looked for at run time, what is said when it is not there, and how its functions are found
//! by their names.
//!
//! Nothing unsafe is done here: a library is loaded by the device crate, in its one place of foreign functions, where
//! [`foreign_functions!`](crate::foreign_functions) is expanded, too.

use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

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

/// Whether [`program_is_static`] was called.
static IS_STATIC: AtomicBool = AtomicBool::new(false);

/// To be called first by a program that is linked statically: only who links it knows. No library is loaded from then on.
pub fn program_is_static() {
    IS_STATIC.store(true, Ordering::Relaxed);
}

/// What is said by a program that has no loader.
const STATIC: &str = "this program is linked statically and can load no library: take one that is linked dynamically, as the \
                      Debian package and cargo install have it";

/// Loads the library from the first place where it is what it should be. `open` says why a file is not. Blocking.
///
/// # Errors
/// [`LibraryMissing`] with each place and its reason; always in a program that is static ([`program_is_static`]): with musl there
/// is no loader, and with glibc loading would bring a second C library into the process.
pub fn load<L>(
    library: &'static str,
    remedy: &str,
    places: Vec<PathBuf>,
    open: impl FnMut(&Path) -> Result<L, String>,
) -> Result<(L, PathBuf), LibraryMissing> {
    load_as(IS_STATIC.load(Ordering::Relaxed), library, remedy, places, open)
}

fn load_as<L>(
    is_static: bool,
    library: &'static str,
    remedy: &str,
    places: Vec<PathBuf>,
    mut open: impl FnMut(&Path) -> Result<L, String>,
) -> Result<(L, PathBuf), LibraryMissing> {
    if is_static {
        return Err(LibraryMissing { library, tried: Vec::new(), remedy: STATIC.to_owned() });
    }
    let mut tried = Vec::new();
    for place in places {
        match open(&place) {
            Ok(loaded) => return Ok((loaded, place)),
            Err(why) => tried.push((place, why)),
        }
    }
    Err(LibraryMissing { library, tried, remedy: remedy.to_owned() })
}

/// Makes `Functions`, the functions of a vendor's library with their names and types, and `Functions::find`, which looks
/// each of them up in a `libloading::Library`. The first words say what a library is not that lacks one of them.
///
/// Expanding it is a promise: each type is that of the function in the vendor's headers, and `Functions` is kept beside
/// the library that it points into. The crate that expands it depends on `libloading` and allows unsafe code there.
#[macro_export]
macro_rules! foreign_functions {
    ($without:literal; $($name:ident: $symbol:literal, fn($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// The functions, by name.
        struct Functions {
            $($name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
        }

        impl Functions {
            /// Looks every function up.
            fn find(library: &libloading::Library) -> Result<Self, String> {
                Ok(Self {
                    $($name: {
                        // SAFETY: the type is that of the function in the headers, and the pointer is only kept beside the
                        // library that it points into: who expands the macro promises both.
                        let found = unsafe {
                            library.get::<unsafe extern "C" fn($($argument),*) $(-> $result)?>($symbol)
                        };
                        *found.map_err(|error| format!("{}: {error}", $without))?
                    },)*
                })
            }
        }
    };
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
    fn the_first_place_that_has_the_library_is_taken() {
        let places: Vec<PathBuf> = ["/a", "/b", "/c"].map(PathBuf::from).into();
        let open = |path: &Path| if path.ends_with("a") { Err("too old".to_owned()) } else { Ok(3) };
        assert_eq!(load("libx", "install it", places.clone(), open), Ok((3, "/b".into())));
        let error = load("libx", "install it", places, |_| Err::<(), _>("none".to_owned())).unwrap_err();
        assert_eq!(error.to_string(), "libx could not be loaded; /a: none; /b: none; /c: none; install it");
    }

    #[test]
    fn a_static_program_says_that_it_can_load_nothing() {
        let open = |_: &Path| -> Result<(), String> { panic!("asked to load") };
        let error = load_as(true, "libx", "install it", vec!["/a".into()], open).unwrap_err();
        assert!(error.to_string().starts_with("libx could not be loaded; this program is linked statically"));
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
