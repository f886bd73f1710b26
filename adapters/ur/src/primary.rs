//! The primary interface: takes scripts, and tells in words what went wrong with them.

use std::collections::VecDeque;

/// Longest packet that is believed, bytes.
const MAX_PACKET: usize = 64 * 1024;
const ROBOT_MESSAGE: u8 = 20;

/// A message for people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PrimaryMessage {
    /// A script's `textmsg`.
    Text(String),
    /// What a program did, for example `PROGRAM_XXX_STARTED`.
    Key {
        /// Title.
        title: String,
        /// Text.
        text: String,
    },
    /// An error code, written `C153A0` in the manufacturer's list.
    Error {
        /// Number after the C.
        code: i32,
        /// Number after the A.
        argument: i32,
        /// Text.
        text: String,
    },
    /// A script failed.
    Exception {
        /// Line.
        line: i32,
        /// Text.
        text: String,
    },
}

impl std::fmt::Display for PrimaryMessage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Key { title, text } => write!(f, "{title} {text}"),
            Self::Error { code, argument, text } => write!(f, "C{code}A{argument} {text}"),
            Self::Exception { line, text } => write!(f, "script line {line}: {text}"),
        }
    }
}

/// Takes messages out of the stream of the primary interface; state is passed over.
#[derive(Debug, Default)]
pub struct PrimaryReader {
    buffer: VecDeque<u8>,
}

/// What the stream cannot be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("primary interface: packet size: found {found}, expected 5 to {MAX_PACKET}")]
pub struct PrimaryError {
    /// Found size.
    pub found: i32,
}

impl PrimaryReader {
    /// Takes bytes, gives the messages that are complete.
    ///
    /// # Errors
    /// [`PrimaryError`]; the stream cannot be followed after that.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<PrimaryMessage>, PrimaryError> {
        self.buffer.extend(bytes);
        let mut messages = Vec::new();
        while self.buffer.len() >= 5 {
            let head: Vec<u8> = self.buffer.iter().take(4).copied().collect();
            let found = head.try_into().map_or(0, i32::from_be_bytes);
            let size = usize::try_from(found).ok().filter(|size| (5..=MAX_PACKET).contains(size));
            let size = size.ok_or(PrimaryError { found })?;
            if self.buffer.len() < size {
                break;
            }
            let packet: Vec<u8> = self.buffer.drain(..size).collect();
            if packet[4] == ROBOT_MESSAGE {
                messages.extend(message(&packet[5..]));
            }
        }
        Ok(messages)
    }
}

/// `u64 timestamp, u8 source, u8 kind, data`; kinds that are of no interest here give nothing.
fn message(body: &[u8]) -> Option<PrimaryMessage> {
    let (head, data) = body.split_first_chunk::<10>()?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned();
    let int = |bytes: &[u8], at: usize| {
        bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(i32::from_be_bytes)
    };
    Some(match head[9] {
        0 => PrimaryMessage::Text(text(data)),
        6 => PrimaryMessage::Error {
            code: int(data, 0)?,
            argument: int(data, 4)?,
            text: text(data.get(20..)?),
        },
        7 => {
            let length = usize::from(*data.get(8)?);
            let (title, rest) = data.get(9..)?.split_at_checked(length)?;
            PrimaryMessage::Key { title: text(title), text: text(rest) }
        }
        10 => PrimaryMessage::Exception { line: int(data, 0)?, text: text(data.get(8..)?) },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn messages_are_read_and_state_is_passed_over() {
        let mut stream = vec![0, 0, 0, 7, 16, 1, 2];
        stream.extend([0, 0, 0, 26, 20]);
        stream.extend([0; 8]);
        stream.extend([0, 10]);
        stream.extend([0, 0, 0, 3, 0, 0, 0, 0]);
        stream.extend(b"bad");
        let mut reader = PrimaryReader::default();
        let mut found = Vec::new();
        for byte in stream {
            found.extend(reader.push(&[byte]).unwrap());
        }
        assert_eq!(found, [PrimaryMessage::Exception { line: 3, text: "bad".into() }]);
        assert_eq!(found[0].to_string(), "script line 3: bad");
        let packet = |kind: u8, data: &[u8]| {
            let size = u32::try_from(15 + data.len()).unwrap();
            [&size.to_be_bytes()[..], &[20], &[0; 8], &[0, kind], data].concat()
        };
        // Code, argument, length of the title, title, text.
        let key = [&[0, 0, 0, 0, 0, 0, 0, 0, 19][..], b"PROGRAM_XXX_STARTEDgraspd_control"].concat();
        // Code, argument, level, type of data, data, text.
        let error =
            [&[0, 0, 0, 210, 0, 0, 0, 4, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0][..], b"read-only"].concat();
        let found = reader.push(&[packet(7, &key), packet(6, &error), packet(0, b"hi")].concat()).unwrap();
        let said: Vec<String> = found.iter().map(ToString::to_string).collect();
        assert_eq!(said, ["PROGRAM_XXX_STARTED graspd_control", "C210A4 read-only", "hi"]);
        let error = PrimaryReader::default().push(&[0xff, 0xff, 0xff, 0xff, 0]).unwrap_err();
        assert!(error.to_string().contains("found -1, expected 5 to"), "{error}");
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..300), cut in 1usize..50) {
            let mut reader = PrimaryReader::default();
            for piece in bytes.chunks(cut) {
                if reader.push(piece).is_err() {
                    break;
                }
            }
            prop_assert!(reader.buffer.len() <= bytes.len());
        }

        #[test]
        fn any_message_is_survived(body in prop::collection::vec(any::<u8>(), 0..60), kind in 0u8..12) {
            let mut body = body;
            if let Some(byte) = body.get_mut(9) {
                *byte = kind;
            }
            let _ = message(&body);
        }
    }
}
