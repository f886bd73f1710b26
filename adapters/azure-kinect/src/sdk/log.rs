//! What the library logs: its only words about why a function failed.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use super::foreign::Sdk;

/// Lines that are kept for the next error.
const KEPT: usize = 4;
/// Longest line that is kept.
const LONGEST: usize = 300;

/// One for the process, as the library's own is.
static LINES: Mutex<VecDeque<String>> = Mutex::new(VecDeque::new());

/// Has warnings and errors of the library sent here instead of to the standard error.
pub(crate) fn listen(sdk: &Sdk) {
    sdk.listen_to_log();
}

/// A line that the library logged. Called on its threads.
pub(crate) fn heard(error: bool, line: &str) {
    let line: String = line.chars().take(LONGEST).collect();
    if error {
        tracing::warn!(library = "libk4a", "{line}");
        let mut lines = LINES.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.len() == KEPT {
            lines.pop_front();
        }
        lines.push_back(line);
    } else {
        tracing::debug!(library = "libk4a", "{line}");
    }
}

/// The lines since they were last taken.
pub(crate) fn take() -> Vec<String> {
    LINES.lock().unwrap_or_else(PoisonError::into_inner).drain(..).collect()
}
