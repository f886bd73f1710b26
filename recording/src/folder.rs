//! A folder of recordings: files one after the other, within a disk budget.

use std::collections::VecDeque;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use crate::file::FileWriter;
use crate::name::file_name;
use crate::read::{self, ReadError};
use crate::schema::Bundle;

/// The smallest budget: less would not hold a few calls.
pub const LEAST_BUDGET_BYTES: u64 = 16 << 20;
/// A file is ended when it is larger than this, or than an eighth of the budget.
const MOST_FILE_BYTES: u64 = 64 << 20;
/// What the schemas, the indexes and the summary of a file may add.
const FILE_OVERHEAD_BYTES: u64 = 192 << 10;
/// Locked while somebody records here.
const LOCK_NAME: &str = "graspd-recording.lock";

/// Why there is no recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// The budget is too small.
    #[error("recording: found a budget of {found} bytes, expected at least {LEAST_BUDGET_BYTES}")]
    Budget {
        /// As given.
        found: u64,
    },
    /// Another process records there.
    #[error("recording: {} is in use by another process", path.display())]
    InUse {
        /// The folder.
        path: PathBuf,
    },
    /// A call is larger than the budget.
    #[error("recording: a call of {found} bytes is larger than the budget of {budget} bytes")]
    TooLarge {
        /// Bytes of the call.
        found: u64,
        /// The budget.
        budget: u64,
    },
    /// The file system refuses.
    #[error("recording: {}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// What was found in a folder when it was opened.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Opened {
    /// Files of earlier runs.
    pub files: usize,
    /// Of those, files that had no end (the process was killed) and have one now.
    pub repaired: usize,
}

/// A folder that is being written to.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    budget: u64,
    file_bytes: u64,
    /// Files that have ended, oldest first, and their bytes.
    ended: VecDeque<(PathBuf, u64)>,
    current: Option<Current>,
    sequence: u32,
    _lock: File,
}

#[derive(Debug)]
struct Current {
    writer: FileWriter,
    path: PathBuf,
    bytes: u64,
}

impl Folder {
    /// Opens a folder, and makes it if there is none. Files that a killed process left without an end get one.
    ///
    /// # Errors
    /// [`FolderError`] for a budget that is too small, a folder in use, and what the file system says.
    pub fn open(path: &Path, budget_bytes: u64) -> Result<(Self, Opened), FolderError> {
        if budget_bytes < LEAST_BUDGET_BYTES {
            return Err(FolderError::Budget { found: budget_bytes });
        }
        let fault = |source| FolderError::Io { path: path.to_owned(), source };
        fs::create_dir_all(path).map_err(fault)?;
        let lock = File::options().write(true).create(true).truncate(false).open(path.join(LOCK_NAME));
        let lock = lock.map_err(fault)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(FolderError::InUse { path: path.to_owned() }),
            Err(TryLockError::Error(source)) => return Err(fault(source)),
        }
        let mut opened = Opened::default();
        let mut ended = VecDeque::new();
        for file in read::files(path).map_err(fault)? {
            opened.files += 1;
            opened.repaired += usize::from(repair(&file).map_err(fault)?);
            let bytes = fs::metadata(&file).map_err(fault)?.len();
            ended.push_back((file, bytes));
        }
        let file_bytes = MOST_FILE_BYTES.min(budget_bytes / 8);
        let path = path.to_owned();
        let folder =
            Self { path, budget: budget_bytes, file_bytes, ended, current: None, sequence: 0, _lock: lock };
        Ok((folder, opened))
    }

    /// Writes a bundle at the time `now_ms` (milliseconds since 1970); the oldest files make room for it. When this
    /// returns it is with the system: a killed process does not lose it, a lost machine may.
    ///
    /// # Errors
    /// [`FolderError::TooLarge`], [`FolderError::Io`]; the next bundle begins a new file then.
    pub fn write(&mut self, now_ms: u64, bundle: &Bundle) -> Result<(), FolderError> {
        let bytes = bundle.len_bytes();
        if bytes + 2 * FILE_OVERHEAD_BYTES > self.budget {
            return Err(FolderError::TooLarge { found: bytes, budget: self.budget });
        }
        if self.current.as_ref().is_some_and(|c| c.bytes + bytes > self.file_bytes) {
            self.end_file()?;
        }
        self.make_room(bytes)?;
        if self.current.is_none() {
            self.current = Some(self.begin_file(now_ms)?);
        }
        self.sequence = self.sequence.wrapping_add(1);
        let Some(current) = &mut self.current else { return Ok(()) };
        if let Err(source) = current.writer.write(self.sequence, bundle) {
            let path = current.path.clone();
            // What is in the file stays; the rest of this bundle is not to come after it.
            self.end_file().ok();
            return Err(FolderError::Io { path, source });
        }
        current.bytes += bytes;
        Ok(())
    }

    /// Ends the file that is being written, so that its end can be read.
    ///
    /// # Errors
    /// [`FolderError::Io`].
    pub fn end_file(&mut self) -> Result<(), FolderError> {
        let Some(Current { writer, path, bytes }) = self.current.take() else { return Ok(()) };
        let finished = writer.finish();
        let bytes = fs::metadata(&path).map_or(bytes, |meta| meta.len());
        self.ended.push_back((path.clone(), bytes));
        finished.map_err(|source| FolderError::Io { path, source })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of all files.
    pub fn used_bytes(&self) -> u64 {
        let current = self.current.as_ref().map_or(0, |c| c.bytes + FILE_OVERHEAD_BYTES);
        self.ended.iter().map(|(_, bytes)| bytes).sum::<u64>() + current
    }

    /// Removes the oldest files until there is room for so many bytes more.
    fn make_room(&mut self, bytes: u64) -> Result<(), FolderError> {
        let needed = bytes + if self.current.is_none() { FILE_OVERHEAD_BYTES } else { 0 };
        while self.used_bytes() + needed > self.budget {
            let Some((path, _)) = self.ended.pop_front() else { return Ok(()) };
            match fs::remove_file(&path) {
                Ok(()) => {}
                // Somebody else has tidied up.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(source) => return Err(FolderError::Io { path, source }),
            }
        }
        Ok(())
    }

    fn begin_file(&self, now_ms: u64) -> Result<Current, FolderError> {
        // Two files of one millisecond: the next free name.
        let mut at = now_ms;
        loop {
            let path = self.path.join(file_name(at));
            match FileWriter::create(&path) {
                Ok(writer) => return Ok(Current { writer, path, bytes: 0 }),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists && at < now_ms + 10_000 => at += 1,
                Err(source) => return Err(FolderError::Io { path, source }),
            }
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // Readers do without the index.
        self.end_file().ok();
    }
}

/// Gives a file an end if it has none; true if that was so. A file without a readable bundle stays as it is.
fn repair(path: &Path) -> io::Result<bool> {
    if read::has_end(path)? {
        return Ok(false);
    }
    let bytes = fs::read(path)?;
    let part = path.with_extension("mcap.part");
    match fs::remove_file(&part) {
        Ok(()) => {}
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let mut writer = FileWriter::create(&part)?;
    let copied = read::bundles(&bytes, |sequence, bundle| writer.write(sequence, &bundle));
    match copied {
        Ok(_) => {
            writer.finish()?;
            fs::rename(&part, path)?;
            Ok(true)
        }
        Err(ReadError::Io { source, .. }) => Err(source),
        Err(_) => {
            drop(writer);
            fs::remove_file(&part)?;
            Ok(false)
        }
    }
}
