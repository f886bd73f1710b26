//! A hand that arrives in pieces: rules for names and sizes, checked before a byte is kept.

use graspd_hands::HandFiles;
use graspd_proto::v1;

use super::is_hand_id;
use crate::convert::quoted;
use crate::error::{FieldError, ServiceError};

/// At most this many files.
const MOST_FILES: usize = 64;
/// At most this many bytes in all files together.
const MOST_BYTES: usize = 32 << 20;
/// Longest name of an upload, bytes.
const LONGEST_REQUEST_ID: usize = 128;
/// Longest path, bytes.
const LONGEST_PATH: usize = 200;

/// An upload in progress.
#[derive(Debug)]
pub(crate) struct Upload {
    /// Id of the new hand.
    pub(crate) hand_id: String,
    /// Check everything and add nothing.
    pub(crate) validate_only: bool,
    /// The caller's name for the upload; may be empty.
    pub(crate) request_id: String,
    /// What has arrived.
    pub(crate) files: HandFiles,
    byte_count: usize,
}

impl Upload {
    /// Begins with the header, which must be the first message.
    pub(crate) fn begin(first: Option<v1::CreateHandRequest>) -> Result<Self, ServiceError> {
        let Some(v1::create_hand_request::Part::Header(header)) = first.and_then(|m| m.part) else {
            return Err(FieldError::missing("header", "a header in the first message").into());
        };
        if !is_hand_id(&header.hand_id) {
            return Err(FieldError::value(
                "header.hand_id",
                quoted(&header.hand_id),
                "a lower-case letter, then at most 62 lower-case letters, digits and hyphens",
            )
            .into());
        }
        if header.request_id.len() > LONGEST_REQUEST_ID {
            return Err(FieldError::value(
                "header.request_id",
                quoted(&header.request_id),
                format!("at most {LONGEST_REQUEST_ID} bytes"),
            )
            .into());
        }
        Ok(Self {
            hand_id: header.hand_id,
            validate_only: header.validate_only,
            request_id: header.request_id,
            files: HandFiles::default(),
            byte_count: 0,
        })
    }

    /// Takes the next message.
    pub(crate) fn push(&mut self, message: v1::CreateHandRequest) -> Result<(), ServiceError> {
        let chunk = match message.part {
            Some(v1::create_hand_request::Part::Chunk(chunk)) => chunk,
            Some(v1::create_hand_request::Part::Header(_)) => {
                return Err(broken("header", "found a second header; expected chunks of files"));
            }
            None => return Err(broken("part", "found an empty message; expected a chunk of a file")),
        };
        if let Some(problem) = path_problem(&chunk.path) {
            return Err(broken(
                "chunk.path",
                format!(
                    "found {}, {problem}; expected a relative path such as \"meshes/tip.stl\"",
                    quoted(&chunk.path)
                ),
            ));
        }
        self.byte_count += chunk.data.len();
        if self.byte_count > MOST_BYTES {
            return Err(broken(
                "chunk.data",
                format!("found more than {MOST_BYTES} bytes in all files together"),
            ));
        }
        let files = &mut self.files.files;
        if !files.contains_key(&chunk.path) && files.len() == MOST_FILES {
            return Err(broken("chunk.path", format!("found more than {MOST_FILES} files")));
        }
        files.entry(chunk.path).or_default().extend_from_slice(&chunk.data);
        Ok(())
    }
}

fn broken(field: &str, problem: impl Into<String>) -> ServiceError {
    ServiceError::BadUpload { field: field.to_owned(), problem: problem.into() }
}

/// What is wrong with a path, if anything.
pub(super) fn path_problem(path: &str) -> Option<&'static str> {
    if path.is_empty() {
        return Some("which is empty");
    }
    if path.len() > LONGEST_PATH {
        return Some("which is too long");
    }
    if path.starts_with('/') {
        return Some("which is absolute");
    }
    if path.chars().any(|c| c.is_control() || c == '\\' || c == ':') {
        return Some("which has a character that no path of a hand needs");
    }
    match path.split('/').find(|part| matches!(*part, "" | "." | "..")) {
        Some("..") => Some("which leaves the hand's folder"),
        Some(_) => Some("which is not in its shortest form"),
        None => None,
    }
}
