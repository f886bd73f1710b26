//! What can be wrong with a hand's files: single problems, and the error that carries them.

use std::fmt;

/// One thing that is wrong, or worth a look, in a hand's files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Path in the hand's folder.
    pub file: String,
    /// The element, key or field inside the file, for example `joint "knuckle" limit`.
    pub field: String,
    /// What was found there.
    pub found: String,
    /// What was expected instead.
    pub expected: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: found {}; expected {}", self.file, self.field, self.found, self.expected)
    }
}

/// Problems found while reading a hand, in the order of their discovery; never empty inside an error.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problems(pub Vec<Problem>);

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, problem) in self.0.iter().enumerate() {
            if i > 0 {
                f.write_str("\n")?;
            }
            write!(f, "{problem}")?;
        }
        Ok(())
    }
}

/// Why a hand's files do not make a hand.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum HandError {
    /// A file that must be there is not.
    #[error("{file}: missing; a hand needs hand.urdf and hand.toml")]
    MissingFile {
        /// Path in the hand's folder.
        file: String,
    },
    /// The id cannot name a hand.
    #[error("id: found {found:?}; expected a lower-case letter, then up to 62 of a-z, 0-9 and '-'")]
    BadId {
        /// The id.
        found: String,
    },
    /// The files contradict themselves or what a hand must be; every problem that was found.
    #[error("{0}")]
    Invalid(Problems),
}

/// Collects problems while a hand is read, so that one reading reports as many as possible.
#[derive(Debug, Default)]
pub(crate) struct Findings {
    /// Problems that make the hand unusable.
    pub(crate) errors: Vec<Problem>,
    /// Things worth a look.
    pub(crate) warnings: Vec<Problem>,
}

impl Findings {
    /// More problems than this are not recorded: hostile files must not make unbounded reports.
    const MOST: usize = 100;

    pub(crate) fn error(
        &mut self,
        file: &str,
        field: impl fmt::Display,
        found: impl fmt::Display,
        expected: impl fmt::Display,
    ) {
        push(&mut self.errors, file, &field, &found, &expected);
    }

    pub(crate) fn warn(
        &mut self,
        file: &str,
        field: impl fmt::Display,
        found: impl fmt::Display,
        expected: impl fmt::Display,
    ) {
        push(&mut self.warnings, file, &field, &found, &expected);
    }

    pub(crate) fn ok(&self) -> bool {
        self.errors.is_empty()
    }
}

fn push(
    list: &mut Vec<Problem>,
    file: &str,
    field: &dyn fmt::Display,
    found: &dyn fmt::Display,
    expected: &dyn fmt::Display,
) {
    if list.len() < Findings::MOST {
        list.push(Problem {
            file: shorten(file),
            field: shorten(&field.to_string()),
            found: shorten(&found.to_string()),
            expected: expected.to_string(),
        });
    }
}

/// Untrusted text in a message: one line, bounded.
fn shorten(text: &str) -> String {
    const MOST: usize = 200;
    let mut line: String = text.chars().take(MOST).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.chars().nth(MOST).is_some() {
        line.push('…');
    }
    line
}
