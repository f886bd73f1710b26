//! Hands in folders on disk: `hand.urdf`, `hand.toml` and meshes, read with the same limits as an upload.

use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use graspd_hands::{Hand, HandError, HandFiles};

use super::{is_hand_id, source, upload};

/// At most this many files in a hand's folder.
const MOST_FILES: usize = 64;
/// At most this many bytes in all files of a hand together.
const MOST_BYTES: u64 = 32 << 20;
/// Deepest nesting of folders in a hand's folder.
const DEEPEST: usize = 4;

/// Why a folder does not make a hand.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// The system refused to read.
    #[error("{path}: cannot be read", path = path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A symbolic link, or something that is neither file nor folder.
    #[error("{path}: found {found}, expected a plain file or a folder", path = path.display())]
    NotPlain {
        /// Where.
        path: PathBuf,
        /// What it is.
        found: &'static str,
    },
    /// Too many files, too many bytes, or folders too deep.
    #[error("{path}: found more than {limit}", path = path.display())]
    TooMuch {
        /// Where.
        path: PathBuf,
        /// The limit, with its unit.
        limit: String,
    },
    /// A name that a hand or its file cannot have.
    #[error("{path}: a name {problem}", path = path.display())]
    Name {
        /// Where.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// Two hands of one id.
    #[error("{path}: there is a hand {id:?} already; rename the folder", path = path.display())]
    Taken {
        /// Where the second one is.
        path: PathBuf,
        /// The id.
        id: String,
    },
    /// The files do not make a hand.
    #[error("{path}: does not make a hand", path = path.display())]
    Hand {
        /// The hand's folder.
        path: PathBuf,
        /// What is wrong.
        source: HandError,
    },
}

/// Reads the files of a hand's folder. Symbolic links are refused, not followed; hidden files are skipped.
///
/// # Errors
/// [`FolderError`] when something cannot be read, is not a plain file, or is too much.
pub fn read_hand_dir(path: &Path) -> Result<HandFiles, FolderError> {
    let mut reading = Reading { files: HandFiles::default(), byte_count: 0 };
    reading.folder(path, "", 0)?;
    Ok(reading.files)
}

/// Every hand of a folder of hands, in the order of their ids.
pub(super) fn read_all(path: &Path) -> Result<Vec<Hand>, FolderError> {
    let mut hands = Vec::new();
    for (name, path) in entries(path)? {
        if !plain_kind(&path)?.is_dir() {
            continue;
        }
        if !is_hand_id(&name) {
            let problem =
                "that is not a hand's id: a lower-case letter, then lower-case letters, digits and hyphens";
            return Err(FolderError::Name { path, problem: problem.to_owned() });
        }
        let files = read_hand_dir(&path)?;
        let loaded = source::load_files(&name, files).map_err(|source| FolderError::Hand { path, source })?;
        hands.push(loaded.hand);
    }
    Ok(hands)
}

struct Reading {
    files: HandFiles,
    byte_count: u64,
}

impl Reading {
    fn folder(&mut self, folder: &Path, prefix: &str, depth: usize) -> Result<(), FolderError> {
        for (name, path) in entries(folder)? {
            let inner = if prefix.is_empty() { name } else { format!("{prefix}/{name}") };
            if let Some(problem) = upload::path_problem(&inner) {
                return Err(FolderError::Name { path, problem: problem.to_owned() });
            }
            if plain_kind(&path)?.is_file() {
                self.file(path, inner)?;
            } else if depth == DEEPEST {
                return Err(FolderError::TooMuch { path, limit: format!("{DEEPEST} nested folders") });
            } else {
                self.folder(&path, &inner, depth + 1)?;
            }
        }
        Ok(())
    }

    fn file(&mut self, path: PathBuf, inner: String) -> Result<(), FolderError> {
        if self.files.files.len() == MOST_FILES {
            return Err(FolderError::TooMuch { path, limit: format!("{MOST_FILES} files") });
        }
        // One byte over the rest of the limit is enough to know that there is more, whatever the size says.
        let mut contents = Vec::new();
        let read = std::fs::File::open(&path)
            .and_then(|file| file.take(MOST_BYTES - self.byte_count + 1).read_to_end(&mut contents));
        match read {
            Err(source) => return Err(FolderError::Io { path, source }),
            Ok(count) => self.byte_count += count as u64,
        }
        if self.byte_count > MOST_BYTES {
            return Err(FolderError::TooMuch { path, limit: format!("{MOST_BYTES} bytes in all files") });
        }
        self.files.files.insert(inner, contents);
        Ok(())
    }
}

/// Names and paths in a folder, sorted, without hidden ones.
fn entries(folder: &Path) -> Result<Vec<(String, PathBuf)>, FolderError> {
    let fault = |source| FolderError::Io { path: folder.to_owned(), source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(fault)? {
        let path = entry.map_err(fault)?.path();
        match path.file_name().and_then(|n| n.to_str()) {
            Some(name) if name.starts_with('.') => {}
            Some(name) => found.push((name.to_owned(), path)),
            None => return Err(FolderError::Name { path, problem: "that is not UTF-8".to_owned() }),
        }
    }
    found.sort();
    Ok(found)
}

/// The kind of a file or folder; an error for anything else.
fn plain_kind(path: &Path) -> Result<std::fs::FileType, FolderError> {
    let kind = std::fs::symlink_metadata(path)
        .map_err(|source| FolderError::Io { path: path.to_owned(), source })?
        .file_type();
    if kind.is_file() || kind.is_dir() {
        return Ok(kind);
    }
    let found = if kind.is_symlink() { "a symbolic link" } else { "a device or a pipe" };
    Err(FolderError::NotPlain { path: path.to_owned(), found })
}
