//! Trays that are done, kept in a file: a long evaluation goes on where it was stopped.
//!
//! One line of JSON says what is measured, then comes one for each tray. A line that was cut off while it was written is
//! dropped; a file of other settings is refused.

use std::fs::{File, OpenOptions};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context as _, ensure};
use graspd_training::evaluate::servo::ServoTray;
use serde::{Deserialize, Serialize};

/// The first line.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    /// Every setting that a tray depends on.
    settings: String,
}

/// The file, and what was in it.
#[derive(Debug)]
pub(super) struct Kept {
    file: Mutex<File>,
    /// Trays that need not be done again.
    pub(super) done: Vec<ServoTray>,
    /// The first line that could not be written.
    fault: Mutex<Option<String>>,
}

impl Kept {
    /// Reads the file if there is one, and begins it if there is none.
    ///
    /// # Errors
    /// For a file that cannot be read or written, has trays of other settings, or is something else.
    pub(super) fn open(path: &Path, settings: &str) -> anyhow::Result<Self> {
        let name = || format!("--resume: {}", path.display());
        let mut file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(path)
            .with_context(name)?;
        let text = std::io::read_to_string(&file).with_context(name)?;
        // What has no end was cut off.
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        file.set_len(whole.len() as u64).with_context(name)?;
        file.seek(SeekFrom::End(0)).with_context(name)?;
        let mut lines = whole.lines();
        let own = Head { settings: settings.to_owned() };
        match lines.next() {
            None => writeln!(file, "{}", serde_json::to_string(&own)?).with_context(name)?,
            Some(line) => {
                let found: Head = serde_json::from_str(line).with_context(name)?;
                ensure!(
                    found == own,
                    "{}: found trays of {:?}, expected of {:?}",
                    name(),
                    found.settings,
                    settings
                );
            }
        }
        let done = lines.map(serde_json::from_str).collect::<Result<_, _>>().with_context(name)?;
        Ok(Self { file: Mutex::new(file), done, fault: Mutex::default() })
    }

    /// Keeps one more tray.
    pub(super) fn add(&self, tray: &ServoTray) {
        let line = serde_json::to_string(tray).map(|line| line + "\n").map_err(std::io::Error::other);
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let written = line.and_then(|line| file.write_all(line.as_bytes()).and_then(|()| file.flush()));
        if let Err(error) = written {
            self.fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error.to_string());
        }
    }

    /// Whether everything was kept.
    ///
    /// # Errors
    /// What the system said when a tray could not be written.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        let fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner).take();
        fault.map_or(Ok(()), |fault| Err(anyhow::anyhow!("--resume: {fault}")))
    }
}

#[cfg(test)]
mod tests {
    use graspd_training::evaluate::servo::Group;

    use super::*;

    fn tray(run: usize) -> ServoTray {
        ServoTray {
            hand: "leap".into(),
            group: Group::Toys,
            run,
            is_dynamic: true,
            objects: 12,
            cleared: 3,
            attempts: Vec::new(),
        }
    }

    #[test]
    fn what_was_kept_is_read_again_but_for_a_line_that_was_cut_off() {
        let path = std::env::temp_dir().join(format!("graspd-trays-{}.jsonl", std::process::id()));
        std::fs::remove_file(&path).ok();
        let kept = Kept::open(&path, "seed 1").unwrap();
        assert!(kept.done.is_empty());
        kept.add(&tray(0));
        kept.add(&tray(1));
        kept.check().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 5]).unwrap();
        let kept = Kept::open(&path, "seed 1").unwrap();
        assert_eq!(kept.done, [tray(0)]);
        kept.add(&tray(2));
        assert_eq!(Kept::open(&path, "seed 1").unwrap().done, [tray(0), tray(2)]);
        let other = Kept::open(&path, "seed 2").unwrap_err().to_string();
        assert!(other.contains("seed 1") && other.contains("seed 2"), "{other}");
        std::fs::write(&path, "something else\n").unwrap();
        assert!(Kept::open(&path, "seed 1").is_err());
        std::fs::remove_file(&path).unwrap();
    }
}
