//! The manufacturer's library, `libk4a` 1.4, looked for at run time.

mod foreign;
mod log;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use graspd_adapters_core::library::{self, LibraryMissing, places};

pub(crate) use foreign::{Configuration, Device, Sdk};

/// Environment variable that names the library, or its folder.
pub const ENVIRONMENT: &str = "K4A_LIB";
const NAMES: [&str; 2] = ["libk4a.so.1.4", "libk4a.so"];
const FOLDERS: [&str; 3] =
    ["/usr/lib/x86_64-linux-gnu", "/usr/lib/x86_64-linux-gnu/libk4a1.4", "/usr/local/lib"];
const REMEDY: &str = "install Microsoft's package libk4a1.4 (with libdepthengine), or name the library in the setting `library` \
                      or in the environment variable K4A_LIB; recordings play without it";

/// Why the library did not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum SdkError {
    /// A function reported failure.
    #[error("{function} failed{}", said(.log))]
    Failed {
        /// Which.
        function: &'static str,
        /// What the library logged last.
        log: Vec<String>,
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

fn said(log: &[String]) -> String {
    if log.is_empty() { String::new() } else { format!(": {}", log.join("; ")) }
}

/// Looks for the library and loads it. Blocking.
pub(crate) fn load(configured: Option<&Path>) -> Result<(Arc<Sdk>, PathBuf), LibraryMissing> {
    let places = places(configured, std::env::var_os(ENVIRONMENT), &NAMES, &FOLDERS);
    library::load("libk4a", REMEDY, places, |place| {
        let sdk = Sdk::load(place)?;
        log::listen(&sdk);
        Ok(Arc::new(sdk))
    })
}
