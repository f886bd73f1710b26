//! The fields of a JSON object, taken one by one; what is wrong is named by its path.

use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use super::SceneError;

/// Longest excerpt of a value in an error.
const EXCERPT: usize = 80;

/// Fields that have not been taken yet.
pub(super) struct Fields {
    path: String,
    map: Map<String, Value>,
}

impl Fields {
    /// The fields of a value that must be an object.
    pub(super) fn new(path: &str, value: Value) -> Result<Self, SceneError> {
        match value {
            Value::Object(map) => Ok(Self { path: path.to_owned(), map }),
            other => Err(SceneError::Field {
                field: path.to_owned(),
                found: excerpt(&other),
                expected: "an object {…}".into(),
            }),
        }
    }

    /// Takes a field that must be there.
    pub(super) fn take<T: DeserializeOwned>(&mut self, name: &str, expected: &str) -> Result<T, SceneError> {
        let Some(value) = self.map.remove(name) else {
            return Err(self.wrong(name, "nothing", expected));
        };
        let found = excerpt(&value);
        serde_json::from_value(value).map_err(|e| self.wrong(name, found, &format!("{expected} ({e})")))
    }

    /// Refuses what has not been taken; gives the path.
    pub(super) fn finish(self) -> Result<String, SceneError> {
        match self.map.iter().next() {
            None => Ok(self.path),
            Some((name, value)) => Err(self.wrong(name, excerpt(value), "no such field")),
        }
    }

    /// An error at one of the fields.
    pub(super) fn wrong(&self, name: &str, found: impl ToString, expected: &str) -> SceneError {
        SceneError::Field {
            field: format!("{}.{name}", self.path),
            found: found.to_string(),
            expected: expected.to_owned(),
        }
    }
}

/// Checks that a number is within bounds, both included.
pub(super) fn within(path: &str, name: &str, value: f64, low: f64, high: f64) -> Result<(), SceneError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(SceneError::Field {
        field: format!("{path}.{name}"),
        found: value.to_string(),
        expected: format!("{low} to {high}"),
    })
}

fn excerpt(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(EXCERPT) {
        Some((at, _)) => format!("{}…", &text[..at]),
        None => text,
    }
}
