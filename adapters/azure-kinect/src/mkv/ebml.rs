//! EBML: elements of an id, a length and a body.
//!
//! A length is only a claim. Bodies are read no farther than the file goes and no longer than the reader allows, and memory
//! is taken for bytes that came, not for bytes that were promised.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

/// Why a file cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MkvError {
    /// The file system refused.
    #[error("byte {at}: {detail}")]
    Io {
        /// Where in the file.
        at: u64,
        /// What it said.
        detail: String,
    },
    /// The file ends within something.
    #[error("byte {at}: the file ends within {what}")]
    Cut {
        /// Where in the file.
        at: u64,
        /// Within what.
        what: &'static str,
    },
    /// Something else stands where it should not.
    #[error("byte {at}: {what}: found {found}, expected {expected}")]
    Wrong {
        /// Where in the file.
        at: u64,
        /// What was read.
        what: &'static str,
        /// Found value.
        found: String,
        /// What is expected.
        expected: String,
    },
}

impl MkvError {
    pub(crate) fn wrong(at: u64, what: &'static str, found: impl ToString, expected: &str) -> Self {
        Self::Wrong { at, what, found: found.to_string(), expected: expected.to_owned() }
    }
}

/// An element's head.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Element {
    /// Id with its length marker.
    pub id: u32,
    /// Where its head begins.
    pub at: u64,
    /// Where its body begins.
    pub body: u64,
    /// Length of its body; `None` for an unknown one, which files have that were written without seeking.
    pub length: Option<u64>,
}

impl Element {
    /// Where its body ends, at most at `limit`; `limit` for an unknown length.
    pub fn end(&self, limit: u64) -> u64 {
        self.length.map_or(limit, |length| self.body.saturating_add(length).min(limit))
    }

    /// True when its body claims to go on after `limit`.
    pub fn exceeds(&self, limit: u64) -> bool {
        self.length.is_some_and(|length| self.body.saturating_add(length) > limit)
    }
}

/// A file, read from place to place.
#[derive(Debug)]
pub struct Source<R> {
    inner: BufReader<R>,
    at: u64,
    len: u64,
}

impl<R: Read + Seek> Source<R> {
    /// Begins at the beginning.
    ///
    /// # Errors
    /// [`MkvError::Io`].
    pub fn new(mut inner: R) -> Result<Self, MkvError> {
        let io = |error: io::Error| MkvError::Io { at: 0, detail: error.to_string() };
        let len = inner.seek(SeekFrom::End(0)).map_err(io)?;
        inner.seek(SeekFrom::Start(0)).map_err(io)?;
        Ok(Self { inner: BufReader::new(inner), at: 0, len })
    }

    /// Length of the file.
    pub fn len(&self) -> u64 {
        self.len
    }

    /// True for a file without a byte.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Where the next byte is read.
    pub fn at(&self) -> u64 {
        self.at
    }

    /// Goes on at another place.
    ///
    /// # Errors
    /// [`MkvError::Io`].
    pub fn seek(&mut self, to: u64) -> Result<(), MkvError> {
        if to == self.at {
            return Ok(());
        }
        let by = i128::from(to) - i128::from(self.at);
        // Within the buffer where possible: heads of blocks lie close together.
        let moved = match i64::try_from(by) {
            Ok(by) => self.inner.seek_relative(by),
            Err(_) => self.inner.seek(SeekFrom::Start(to)).map(|_| ()),
        };
        moved.map_err(|error| MkvError::Io { at: to, detail: error.to_string() })?;
        self.at = to;
        Ok(())
    }

    fn fill(&mut self, bytes: &mut [u8], what: &'static str) -> Result<(), MkvError> {
        let at = self.at;
        self.inner.read_exact(bytes).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => MkvError::Cut { at, what },
            _ => MkvError::Io { at, detail: error.to_string() },
        })?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    /// The next byte.
    ///
    /// # Errors
    /// [`MkvError::Cut`], [`MkvError::Io`].
    pub fn byte(&mut self, what: &'static str) -> Result<u8, MkvError> {
        let mut byte = [0];
        self.fill(&mut byte, what)?;
        Ok(byte[0])
    }

    /// A number whose first byte tells its length; with its marker as ids are, without as lengths are.
    fn marked(&mut self, what: &'static str, longest: u32, keep: bool) -> Result<(u64, u32), MkvError> {
        let at = self.at;
        let first = self.byte(what)?;
        let length = first.leading_zeros() + 1;
        if length > longest {
            let found = format!("a first byte of {first:#04x}");
            return Err(MkvError::wrong(at, what, found, "a number of at most 8 bytes, an id of at most 4"));
        }
        let mut value = u64::from(first);
        if !keep {
            value &= (1u64 << (8 - length)) - 1;
        }
        for _ in 1..length {
            value = value << 8 | u64::from(self.byte(what)?);
        }
        Ok((value, length))
    }

    /// A number of up to 8 bytes, and how many it took.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn number(&mut self, what: &'static str) -> Result<(u64, u32), MkvError> {
        self.marked(what, 8, false)
    }

    /// The head of the next element.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn element(&mut self) -> Result<Element, MkvError> {
        let at = self.at;
        let (id, _) = self.marked("an element's id", 4, true)?;
        let (length, bytes) = self.number("an element's length")?;
        let unknown = length == (1u64 << (7 * bytes)) - 1;
        let id = u32::try_from(id).unwrap_or(0);
        Ok(Element { id, at, body: self.at, length: (!unknown).then_some(length) })
    }

    /// The body of an element that is not longer than `most`; it must lie in the file.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn body(&mut self, element: &Element, most: u64, what: &'static str) -> Result<Vec<u8>, MkvError> {
        let Some(length) = element.length else {
            return Err(MkvError::wrong(element.at, what, "an unknown length", "a known one"));
        };
        self.bytes(element.body, length, most, what)
    }

    /// Bytes from a place, not more than `most`; they must lie in the file.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn bytes(
        &mut self,
        at: u64,
        length: u64,
        most: u64,
        what: &'static str,
    ) -> Result<Vec<u8>, MkvError> {
        if length > most {
            let found = format!("{length} bytes");
            return Err(MkvError::wrong(at, what, found, &format!("at most {most} bytes")));
        }
        if at.saturating_add(length) > self.len {
            return Err(MkvError::Cut { at, what });
        }
        self.seek(at)?;
        let mut bytes = Vec::new();
        let read = (&mut self.inner).take(length).read_to_end(&mut bytes);
        let read = read.map_err(|error| MkvError::Io { at, detail: error.to_string() })?;
        self.at += read as u64;
        if bytes.len() as u64 != length {
            return Err(MkvError::Cut { at, what });
        }
        Ok(bytes)
    }

    /// An unsigned integer of up to 8 bytes.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn unsigned(&mut self, element: &Element, what: &'static str) -> Result<u64, MkvError> {
        let bytes = self.body(element, 8, what)?;
        Ok(bytes.iter().fold(0, |value, byte| value << 8 | u64::from(*byte)))
    }

    /// A text of up to 4096 bytes; zeros at its end are no part of it.
    ///
    /// # Errors
    /// [`MkvError`].
    pub fn text(&mut self, element: &Element, what: &'static str) -> Result<String, MkvError> {
        let bytes = self.body(element, 4096, what)?;
        let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
        match std::str::from_utf8(&bytes[..end]) {
            Ok(text) => Ok(text.to_owned()),
            Err(error) => Err(MkvError::wrong(element.body, what, error, "UTF-8 text")),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use proptest::prelude::*;

    #[test]
    fn heads_are_read_as_the_format_has_them() {
        let mut source = Source::new(Cursor::new(vec![0x1a, 0x45, 0xdf, 0xa3, 0x9f])).unwrap();
        let head = source.element().unwrap();
        assert_eq!(head, Element { id: 0x1A45_DFA3, at: 0, body: 5, length: Some(31) });
        let unknown = [0x1f, 0x43, 0xb6, 0x75, 0x01, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff];
        let head = Source::new(Cursor::new(unknown)).unwrap().element().unwrap();
        assert_eq!((head.length, head.end(100), head.exceeds(100)), (None, 100, false));
        let long = Source::new(Cursor::new(vec![0x63, 0xc0, 0x40, 0x02])).unwrap().element().unwrap();
        assert_eq!((long.id, long.length), (0x63C0, Some(2)));
    }

    #[test]
    fn a_promised_length_takes_no_memory() {
        let mut bytes = vec![0x46, 0x5c, 0x01, 0x00, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff];
        bytes.extend([7; 20]);
        let mut source = Source::new(Cursor::new(bytes)).unwrap();
        let head = source.element().unwrap();
        let refused = source.body(&head, u64::MAX, "a file").unwrap_err();
        assert_eq!(refused, MkvError::Cut { at: 10, what: "a file" });
        let refused = source.body(&head, 1000, "a file").unwrap_err().to_string();
        assert!(refused.contains("at most 1000 bytes"), "{refused}");
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_end_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut source = Source::new(Cursor::new(bytes)).unwrap();
            while let Ok(head) = source.element() {
                let _bytes = source.body(&head, 1 << 40, "a body");
                if source.seek(head.end(source.len()).max(head.body)).is_err() || source.at() >= source.len() {
                    break;
                }
            }
        }
    }
}
