//! Packages: `u16 size` of the whole, `u8 type`, payload.

use super::{Kind, RtdeError, Value};

/// Longest package that is believed, bytes. The header could say 65535; what is set up here is far less.
pub const MAX_PACKAGE: usize = 8192;

/// How bad a text message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextLevel {
    /// 0.
    Exception,
    /// 1.
    Error,
    /// 2.
    Warning,
    /// 3, or any other number.
    Info,
}

/// What the controller wants to be read by people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextMessage {
    /// The text.
    pub text: String,
    /// Who says it.
    pub source: String,
    /// How bad.
    pub level: TextLevel,
}

/// A package of either direction; payloads of setups and data stay bytes until their recipe is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Package {
    /// `V`: accepted or not.
    ProtocolVersion(bool),
    /// `v`: major, minor, bugfix, build.
    ControllerVersion([u32; 4]),
    /// `M`.
    Text(TextMessage),
    /// `U`: recipe and bytes of its fields.
    Data {
        /// Number of the recipe.
        recipe: u8,
        /// Bytes of its fields.
        bytes: Vec<u8>,
    },
    /// `O`: recipe, and the words of types.
    Outputs {
        /// Number of the recipe; 0 for none.
        recipe: u8,
        /// Words of types.
        types: Vec<String>,
    },
    /// `I`: recipe, and the words of types.
    Inputs {
        /// Number of the recipe; 0 for none.
        recipe: u8,
        /// Words of types.
        types: Vec<String>,
    },
    /// `S`: accepted or not.
    Start(bool),
    /// `P`: accepted or not.
    Pause(bool),
}

fn malformed(field: &str, found: impl ToString, expected: impl Into<String>) -> RtdeError {
    RtdeError::Malformed { field: field.to_owned(), found: found.to_string(), expected: expected.into() }
}

fn accepted(field: &'static str, payload: &[u8]) -> Result<bool, RtdeError> {
    match payload {
        [0] => Ok(false),
        [1] => Ok(true),
        other => Err(malformed(field, format!("{other:02x?}"), "one byte, 0 or 1")),
    }
}

fn recipe(field: &'static str, payload: &[u8]) -> Result<(u8, Vec<String>), RtdeError> {
    let (id, words) = payload.split_first().ok_or_else(|| malformed(field, "0 bytes", "a recipe"))?;
    let words = std::str::from_utf8(words).map_err(|_| malformed(field, "bytes", "names of types"))?;
    Ok((*id, words.split(',').map(str::trim).filter(|w| !w.is_empty()).map(str::to_owned).collect()))
}

fn text_message(payload: &[u8]) -> Option<TextMessage> {
    let (length, rest) = payload.split_first()?;
    let (text, rest) = rest.split_at_checked(usize::from(*length))?;
    let (length, rest) = rest.split_first()?;
    let (source, rest) = rest.split_at_checked(usize::from(*length))?;
    let level = match rest {
        [0] => TextLevel::Exception,
        [1] => TextLevel::Error,
        [2] => TextLevel::Warning,
        [_] => TextLevel::Info,
        _ => return None,
    };
    let text = String::from_utf8_lossy(text).into_owned();
    Some(TextMessage { text, source: String::from_utf8_lossy(source).into_owned(), level })
}

impl Package {
    /// Reads the payload of a package from the controller.
    ///
    /// # Errors
    /// [`RtdeError::Malformed`].
    pub fn decode(kind: u8, payload: &[u8]) -> Result<Self, RtdeError> {
        Ok(match kind {
            b'V' => Self::ProtocolVersion(accepted("reply to protocol version", payload)?),
            b'v' => {
                let mut rest = payload;
                let mut version = [0; 4];
                for number in &mut version {
                    let value = Value::read(Kind::Uint32, "controller version", &mut rest)?;
                    *number = if let Value::Uint32(value) = value { value } else { 0 };
                }
                if !rest.is_empty() {
                    return Err(malformed(
                        "controller version",
                        format!("{} bytes", payload.len()),
                        "16 bytes",
                    ));
                }
                Self::ControllerVersion(version)
            }
            b'M' => {
                let message = text_message(payload);
                let expected = "length, text, length, source, level";
                Self::Text(
                    message.ok_or_else(|| {
                        malformed("text message", format!("{} bytes", payload.len()), expected)
                    })?,
                )
            }
            b'U' => {
                let (recipe, bytes) =
                    payload.split_first().ok_or_else(|| malformed("data", "0 bytes", "a recipe"))?;
                Self::Data { recipe: *recipe, bytes: bytes.to_vec() }
            }
            b'O' => {
                recipe("reply to outputs", payload).map(|(recipe, types)| Self::Outputs { recipe, types })?
            }
            b'I' => {
                recipe("reply to inputs", payload).map(|(recipe, types)| Self::Inputs { recipe, types })?
            }
            b'S' => Self::Start(accepted("reply to start", payload)?),
            b'P' => Self::Pause(accepted("reply to pause", payload)?),
            other => return Err(malformed("type", other, "one of V v M U O I S P")),
        })
    }
}

/// A package's bytes.
pub(super) fn encode(kind: u8, payload: &[u8]) -> Result<Vec<u8>, RtdeError> {
    let size = payload.len() + 3;
    let short = u16::try_from(size).map_err(|_| malformed("size to send", size, "at most 65535"))?;
    let mut out = Vec::with_capacity(size);
    out.extend(short.to_be_bytes());
    out.push(kind);
    out.extend(payload);
    Ok(out)
}

/// Takes packages out of a stream of bytes, however it is cut.
#[derive(Debug, Default)]
pub struct PackageReader {
    buffer: Vec<u8>,
    start: usize,
}

impl PackageReader {
    /// Room for more bytes: at its end, what comes next is appended.
    pub(super) fn buffer(&mut self) -> &mut Vec<u8> {
        if self.start > 0 {
            self.buffer.drain(..self.start);
            self.start = 0;
        }
        &mut self.buffer
    }

    /// Appends bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer().extend_from_slice(bytes);
    }

    /// The next package that is complete.
    ///
    /// # Errors
    /// [`RtdeError::Malformed`]; the stream cannot be followed after that.
    pub fn next_package(&mut self) -> Result<Option<Package>, RtdeError> {
        let rest = &self.buffer[self.start..];
        let [high, low, kind, ..] = *rest else { return Ok(None) };
        let size = usize::from(u16::from_be_bytes([high, low]));
        if !(3..=MAX_PACKAGE).contains(&size) {
            return Err(malformed("size", size, format!("3 to {MAX_PACKAGE}")));
        }
        let Some(payload) = rest.get(3..size) else { return Ok(None) };
        let package = Package::decode(kind, payload)?;
        self.start += size;
        Ok(Some(package))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(bytes: &[u8]) -> Result<Option<Package>, RtdeError> {
        let mut reader = PackageReader::default();
        reader.push(bytes);
        reader.next_package()
    }

    #[test]
    fn published_packages_are_read_and_written() {
        assert_eq!(encode(b'V', &[0, 2]).unwrap(), [0x00, 0x05, 0x56, 0x00, 0x02]);
        assert_eq!(read(&[0x00, 0x04, 0x56, 0x01]).unwrap(), Some(Package::ProtocolVersion(true)));
        assert_eq!(encode(b'v', &[]).unwrap(), [0x00, 0x03, 0x76]);
        let version = [0x00, 0x13, 0x76, 0, 0, 0, 5, 0, 0, 0, 0x11, 0, 0, 0, 3, 0, 0, 0, 0];
        assert_eq!(read(&version).unwrap(), Some(Package::ControllerVersion([5, 17, 3, 0])));
        let mut outputs = vec![0x00, 0x19, 0x4f, 0x01];
        outputs.extend(b"DOUBLE,VECTOR6D,INT32");
        let types = ["DOUBLE", "VECTOR6D", "INT32"].map(str::to_owned).to_vec();
        assert_eq!(read(&outputs).unwrap(), Some(Package::Outputs { recipe: 1, types }));
        let mut inputs = vec![0x00, 0x11, 0x49, 0x01];
        inputs.extend(b"UINT32,DOUBLE");
        let types = ["UINT32", "DOUBLE"].map(str::to_owned).to_vec();
        assert_eq!(read(&inputs).unwrap(), Some(Package::Inputs { recipe: 1, types }));
        assert_eq!(encode(b'S', &[]).unwrap(), [0x00, 0x03, 0x53]);
        assert_eq!(read(&[0x00, 0x04, 0x53, 0x01]).unwrap(), Some(Package::Start(true)));
        assert_eq!(encode(b'P', &[]).unwrap(), [0x00, 0x03, 0x50]);
        assert_eq!(read(&[0x00, 0x04, 0x50, 0x01]).unwrap(), Some(Package::Pause(true)));
        let mut data = vec![1];
        Value::Uint32(1).write(&mut data);
        Value::Double(0.5).write(&mut data);
        let expected = [0x00, 0x10, 0x55, 0x01, 0, 0, 0, 1, 0x3f, 0xe0, 0, 0, 0, 0, 0, 0];
        assert_eq!(encode(b'U', &data).unwrap(), expected);
        let text =
            Package::Text(TextMessage { text: "hi".into(), source: "RTD".into(), level: TextLevel::Warning });
        let bytes = [0x00, 0x0b, 0x4d, 2, b'h', b'i', 3, b'R', b'T', b'D', 2];
        assert_eq!(read(&bytes).unwrap(), Some(text));
    }

    #[test]
    fn errors_say_the_field_what_was_found_and_what_was_expected() {
        for (bytes, expected) in [
            (&[0x00, 0x02, 0x56][..], "RTDE size: found 2, expected 3 to 8192"),
            (&[0xff, 0xff, 0x56], "RTDE size: found 65535"),
            (&[0x00, 0x04, 0x56, 0x07], "reply to protocol version: found [07], expected one byte, 0 or 1"),
            (&[0x00, 0x04, 0x58, 0x00], "RTDE type: found 88, expected one of"),
            (&[0x00, 0x05, 0x76, 0x00, 0x00], "controller version: found 2 bytes, expected 4 bytes"),
        ] {
            let error = read(bytes).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    proptest! {
        #[test]
        fn any_bytes_are_survived_however_they_are_cut(
            bytes in prop::collection::vec(any::<u8>(), 0..400), cut in 1usize..40
        ) {
            let mut reader = PackageReader::default();
            for piece in bytes.chunks(cut) {
                reader.push(piece);
                while let Ok(Some(_)) = reader.next_package() {}
                prop_assert!(reader.buffer.len() <= bytes.len());
            }
        }

        #[test]
        fn packages_come_out_however_they_are_cut(cut in 1usize..30, count in 1usize..20) {
            let one = [0x00, 0x06, 0x55, 0x01, 0xaa, 0xbb];
            let stream = one.repeat(count);
            let mut reader = PackageReader::default();
            let mut found = 0;
            for piece in stream.chunks(cut) {
                reader.push(piece);
                while let Some(package) = reader.next_package().unwrap() {
                    prop_assert_eq!(package, Package::Data { recipe: 1, bytes: vec![0xaa, 0xbb] });
                    found += 1;
                }
            }
            prop_assert_eq!(found, count);
        }

        #[test]
        fn values_come_back(word in 0usize..10, bytes in prop::collection::vec(any::<u8>(), 48)) {
            let kind = Kind::WORDS[word].0;
            let mut rest = &bytes[..];
            if let Ok(value) = Value::read(kind, "f", &mut rest) {
                prop_assert_eq!(bytes.len() - rest.len(), kind.size());
                let mut written = Vec::new();
                value.write(&mut written);
                prop_assert_eq!(&written[..], &bytes[..kind.size()]);
            }
        }
    }
}
