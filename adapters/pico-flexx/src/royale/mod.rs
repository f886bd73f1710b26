//! The manufacturer's library Royale, by its C interface (`libroyaleCAPI`), looked for at run time.
//!
//! Names and layouts are those of the headers of Royale 3.7 to 3.10, whose exported names carry the version in which each
//! function last changed (`…_v210`, `…_v220`, `…_v300`). Versions 4 and 5 changed some of them, among these the depth data:
//! only version 3 is taken.

mod foreign;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use graspd_adapters_core::library::{self, LibraryMissing, places};

pub(crate) use foreign::{Camera, Picture, Point, Royale};

/// Environment variable that names the library, or its folder.
pub const ENVIRONMENT: &str = "ROYALE_LIB";
const NAMES: [&str; 1] = ["libroyaleCAPI.so"];
const FOLDERS: [&str; 3] = ["/usr/local/lib", "/usr/lib/x86_64-linux-gnu", "/opt/royale/lib"];
const REMEDY: &str = "install the Royale SDK 3.x of pmd (after registration there) and name `libroyaleCAPI.so` in the setting \
                      `library` or in the environment variable ROYALE_LIB; or use the source `rosbridge`";
/// The version whose layouts are known.
const MAJOR: u32 = 3;

/// Why the library did not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum RoyaleError {
    /// A function reported failure.
    #[error("{function}: status {status} ({})", status_name(*.status))]
    Failed {
        /// Which.
        function: &'static str,
        /// Status.
        status: i32,
    },
    /// It gave something that cannot be.
    #[error("{function}: {detail}")]
    Impossible {
        /// Which function.
        function: &'static str,
        /// What was wrong.
        detail: String,
    },
}

impl RoyaleError {
    /// True when the camera is gone, or busy: trying again may help.
    pub(crate) fn is_transient(&self) -> bool {
        matches!(self, Self::Failed { status: 1024 | 1026 | 1028 | 4098 | 4100, .. })
    }
}

/// The status codes of the headers.
fn status_name(status: i32) -> &'static str {
    match status {
        1024 => "runtime error",
        1026 => "disconnected",
        1028 => "timeout",
        2048 => "logic error",
        4098 => "could not open",
        4100 => "resource busy",
        5001 => "use case not supported",
        5004 => "not initialized",
        5006 => "insufficient privileges",
        5011 => "duty cycle too high",
        0x7fff_ff02 => "invalid handle",
        _ => "not in the known list",
    }
}

/// Looks for the library and loads it. Blocking.
pub(crate) fn load(configured: Option<&Path>) -> Result<(Arc<Royale>, PathBuf), LibraryMissing> {
    let places = places(configured, std::env::var_os(ENVIRONMENT), &NAMES, &FOLDERS);
    library::load("libroyaleCAPI", REMEDY, places, |place| {
        let royale = Royale::load(place)?;
        let [major, minor, patch] = royale.version();
        if major == MAJOR {
            return Ok(Arc::new(royale));
        }
        Err(format!("found version {major}.{minor}.{patch}, expected {MAJOR}.x"))
    })
}
