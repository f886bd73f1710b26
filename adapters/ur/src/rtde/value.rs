//! Typed values of RTDE fields, big-endian on the wire.

use super::RtdeError;

/// Types on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// One byte, 0 or 1.
    Bool,
    /// One byte.
    Uint8,
    /// Four bytes.
    Uint32,
    /// Four bytes.
    Int32,
    /// Eight bytes.
    Uint64,
    /// Eight bytes, IEEE 754.
    Double,
    /// Three doubles.
    Vector3d,
    /// Six doubles.
    Vector6d,
    /// Six signed integers of four bytes.
    Vector6Int32,
    /// Six unsigned integers of four bytes.
    Vector6Uint32,
}

impl Kind {
    /// All, with the words that the controller uses.
    pub const WORDS: [(Self, &'static str); 10] = [
        (Self::Bool, "BOOL"),
        (Self::Uint8, "UINT8"),
        (Self::Uint32, "UINT32"),
        (Self::Int32, "INT32"),
        (Self::Uint64, "UINT64"),
        (Self::Double, "DOUBLE"),
        (Self::Vector3d, "VECTOR3D"),
        (Self::Vector6d, "VECTOR6D"),
        (Self::Vector6Int32, "VECTOR6INT32"),
        (Self::Vector6Uint32, "VECTOR6UINT32"),
    ];

    /// The kind of a word.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::WORDS.iter().find(|(_, w)| *w == word).map(|(kind, _)| *kind)
    }

    /// The controller's word.
    pub fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(kind, _)| *kind == self).map_or("", |(_, word)| word)
    }

    /// Bytes on the wire.
    pub const fn size(self) -> usize {
        match self {
            Self::Bool | Self::Uint8 => 1,
            Self::Uint32 | Self::Int32 => 4,
            Self::Uint64 | Self::Double => 8,
            Self::Vector3d | Self::Vector6Int32 | Self::Vector6Uint32 => 24,
            Self::Vector6d => 48,
        }
    }
}

/// A value of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Value {
    /// See [`Kind::Bool`].
    Bool(bool),
    /// See [`Kind::Uint8`].
    Uint8(u8),
    /// See [`Kind::Uint32`].
    Uint32(u32),
    /// See [`Kind::Int32`].
    Int32(i32),
    /// See [`Kind::Uint64`].
    Uint64(u64),
    /// See [`Kind::Double`].
    Double(f64),
    /// See [`Kind::Vector3d`].
    Vector3d([f64; 3]),
    /// See [`Kind::Vector6d`].
    Vector6d([f64; 6]),
    /// See [`Kind::Vector6Int32`].
    Vector6Int32([i32; 6]),
    /// See [`Kind::Vector6Uint32`].
    Vector6Uint32([u32; 6]),
}

/// Takes the next `N` bytes.
fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*first)
}

fn many<const N: usize, const S: usize, T: Default + Copy>(
    bytes: &mut &[u8],
    read: impl Fn([u8; S]) -> T,
) -> Option<[T; N]> {
    let mut out = [T::default(); N];
    for value in &mut out {
        *value = read(take(bytes)?);
    }
    Some(out)
}

impl Value {
    /// Its kind.
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Bool(_) => Kind::Bool,
            Self::Uint8(_) => Kind::Uint8,
            Self::Uint32(_) => Kind::Uint32,
            Self::Int32(_) => Kind::Int32,
            Self::Uint64(_) => Kind::Uint64,
            Self::Double(_) => Kind::Double,
            Self::Vector3d(_) => Kind::Vector3d,
            Self::Vector6d(_) => Kind::Vector6d,
            Self::Vector6Int32(_) => Kind::Vector6Int32,
            Self::Vector6Uint32(_) => Kind::Vector6Uint32,
        }
    }

    /// Reads a value off the front of bytes.
    ///
    /// # Errors
    /// [`RtdeError::Malformed`] for too few bytes, and for a boolean that is neither 0 nor 1.
    pub fn read(kind: Kind, field: &str, bytes: &mut &[u8]) -> Result<Self, RtdeError> {
        let available = bytes.len();
        let value = match kind {
            Kind::Bool => match take(bytes) {
                Some([0]) => Some(Self::Bool(false)),
                Some([1]) => Some(Self::Bool(true)),
                Some([other]) => {
                    return Err(RtdeError::Malformed {
                        field: field.to_owned(),
                        found: other.to_string(),
                        expected: "0 or 1".into(),
                    });
                }
                None => None,
            },
            Kind::Uint8 => take(bytes).map(|[byte]| Self::Uint8(byte)),
            Kind::Uint32 => take(bytes).map(|b| Self::Uint32(u32::from_be_bytes(b))),
            Kind::Int32 => take(bytes).map(|b| Self::Int32(i32::from_be_bytes(b))),
            Kind::Uint64 => take(bytes).map(|b| Self::Uint64(u64::from_be_bytes(b))),
            Kind::Double => take(bytes).map(|b| Self::Double(f64::from_be_bytes(b))),
            Kind::Vector3d => many(bytes, f64::from_be_bytes).map(Self::Vector3d),
            Kind::Vector6d => many(bytes, f64::from_be_bytes).map(Self::Vector6d),
            Kind::Vector6Int32 => many(bytes, i32::from_be_bytes).map(Self::Vector6Int32),
            Kind::Vector6Uint32 => many(bytes, u32::from_be_bytes).map(Self::Vector6Uint32),
        };
        value.ok_or_else(|| RtdeError::Malformed {
            field: field.to_owned(),
            found: format!("{available} bytes"),
            expected: format!("{} bytes of a {}", kind.size(), kind.word()),
        })
    }

    /// Appends its bytes.
    pub fn write(&self, to: &mut Vec<u8>) {
        match self {
            Self::Bool(v) => to.push(u8::from(*v)),
            Self::Uint8(v) => to.push(*v),
            Self::Uint32(v) => to.extend(v.to_be_bytes()),
            Self::Int32(v) => to.extend(v.to_be_bytes()),
            Self::Uint64(v) => to.extend(v.to_be_bytes()),
            Self::Double(v) => to.extend(v.to_be_bytes()),
            Self::Vector3d(v) => v.iter().for_each(|v| to.extend(v.to_be_bytes())),
            Self::Vector6d(v) => v.iter().for_each(|v| to.extend(v.to_be_bytes())),
            Self::Vector6Int32(v) => v.iter().for_each(|v| to.extend(v.to_be_bytes())),
            Self::Vector6Uint32(v) => v.iter().for_each(|v| to.extend(v.to_be_bytes())),
        }
    }

    /// Six doubles, if it is that.
    pub fn vector6(&self) -> Option<[f64; 6]> {
        if let Self::Vector6d(value) = self { Some(*value) } else { None }
    }

    /// A double, if it is one.
    pub fn double(&self) -> Option<f64> {
        if let Self::Double(value) = self { Some(*value) } else { None }
    }

    /// An integer of at most four bytes, if it is one.
    pub fn integer(&self) -> Option<i64> {
        match self {
            Self::Uint8(v) => Some(i64::from(*v)),
            Self::Uint32(v) => Some(i64::from(*v)),
            Self::Int32(v) => Some(i64::from(*v)),
            _ => None,
        }
    }
}
