//! Reading shards: an index by hopping from record to record, samples at random, and how far an interrupted run came.

use std::io::{Read, Seek, SeekFrom};

use flate2::read::ZlibDecoder;
use graspd_planner::grid::Grid;

use super::sample::{Sample, SampleError};
use super::shard::{FORMAT, Header, MAGIC, MAX_HEADER, MAX_PACKED, PREFIX, RECORD_PREFIX, VERSION, crc};

/// Why a shard cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The system refuses.
    #[error("the shard cannot be read")]
    Io(#[from] std::io::Error),
    /// A part of the file is not what it should be.
    #[error("{part}: found {found}, expected {expected}")]
    Part {
        /// For example `header.length`.
        part: String,
        /// What was found.
        found: String,
        /// What is expected.
        expected: String,
    },
    /// A record's payload is not what it should be.
    #[error("record {record}: {source}")]
    Sample {
        /// Number of the record.
        record: usize,
        /// What is wrong with it.
        source: SampleError,
    },
}

fn wrong(part: impl Into<String>, found: impl ToString, expected: impl ToString) -> ReadError {
    ReadError::Part { part: part.into(), found: found.to_string(), expected: expected.to_string() }
}

/// A shard, open for reading.
#[derive(Debug)]
pub struct Shard<R> {
    source: R,
    header: Header,
    /// Where each record starts, and its packed length.
    records: Vec<(u64, u32)>,
    /// Where the last whole record ends.
    end: u64,
    /// Length of the file.
    length: u64,
}

impl<R: Read + Seek> Shard<R> {
    /// Reads the header and finds the records. A last record that is cut off is left out; see [`Shard::left_over`].
    ///
    /// # Errors
    /// [`ReadError`] for what is no shard of this version, and when the system refuses.
    pub fn open(mut source: R) -> Result<Self, ReadError> {
        let length = source.seek(SeekFrom::End(0))?;
        source.seek(SeekFrom::Start(0))?;
        let (header, mut end) = read_header(&mut source, length)?;
        let mut records = Vec::new();
        while let Some(start) =
            length.checked_sub(RECORD_PREFIX as u64).filter(|last| end <= *last).map(|_| end)
        {
            source.seek(SeekFrom::Start(start))?;
            let packed = read_u32(&mut source)?;
            let next = start + RECORD_PREFIX as u64 + u64::from(packed);
            if next > length || packed as usize > MAX_PACKED {
                break;
            }
            records.push((start, packed));
            end = next;
        }
        Ok(Self { source, header, records, end, length })
    }

    /// The header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Whole records.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// True when there is no whole record.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Where the last whole record ends, bytes from the start.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Bytes behind the last whole record: an interrupted run's, or damage.
    pub fn left_over(&self) -> u64 {
        self.length - self.end
    }

    /// Reads a record's payload and checks its CRC.
    fn packed(&mut self, record: usize) -> Result<Vec<u8>, ReadError> {
        let count = self.records.len();
        let &(start, length) = self
            .records
            .get(record)
            .ok_or_else(|| wrong("record", record, format!("a number below {count}")))?;
        self.source.seek(SeekFrom::Start(start + 4))?;
        let expected = read_u32(&mut self.source)?;
        let mut packed = vec![0; length as usize];
        self.source.read_exact(&mut packed)?;
        let found = crc(&packed);
        if found == expected {
            return Ok(packed);
        }
        Err(wrong(format!("record {record}: CRC-32"), format!("{found:08x}"), format!("{expected:08x}")))
    }

    /// The sample of a record.
    ///
    /// # Errors
    /// [`ReadError`] for a record that does not exist, is damaged, or holds no sample of the header's grid.
    pub fn read(&mut self, record: usize) -> Result<Sample, ReadError> {
        let packed = self.packed(record)?;
        let grid = Grid::from(self.header.grid);
        // All that a payload can hold: volumes, a label of each kind in every voxel, the largest preview.
        let most = 19 * grid.len() + 2 * usize::from(u16::MAX).pow(2);
        let mut payload = Vec::new();
        ZlibDecoder::new(packed.as_slice())
            .take(most as u64)
            .read_to_end(&mut payload)
            .map_err(|e| wrong(format!("record {record}: payload"), e, "a zlib stream"))?;
        let sample = Sample::from_bytes(&payload).map_err(|source| ReadError::Sample { record, source })?;
        if sample.resolution as usize != grid.resolution {
            let part = format!("record {record}: resolution");
            return Err(wrong(part, sample.resolution, format!("the header's {}", grid.resolution)));
        }
        Ok(sample)
    }

    /// How far a run that wrote this shard came: whole records, in the order in which they are written, and where the last
    /// of them ends. A last record with a wrong CRC counts as cut off.
    ///
    /// # Errors
    /// [`ReadError`] for damage before the last record.
    pub fn progress(&mut self) -> Result<(usize, u64), ReadError> {
        let last = self.records.len().saturating_sub(1);
        for record in 0..self.records.len() {
            match self.packed(record) {
                Ok(_) => {}
                Err(ReadError::Part { .. }) if record == last => return Ok((record, self.records[record].0)),
                Err(error) => return Err(error),
            }
        }
        Ok((self.records.len(), self.end))
    }
}

fn read_u32(source: &mut impl Read) -> Result<u32, ReadError> {
    let mut bytes = [0; 4];
    source.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

/// The header, and where it ends.
fn read_header(source: &mut impl Read, length: u64) -> Result<(Header, u64), ReadError> {
    if length < PREFIX as u64 {
        return Err(wrong("shard", format!("{length} bytes"), format!("at least {PREFIX}")));
    }
    let mut magic = [0; 4];
    source.read_exact(&mut magic)?;
    if magic != MAGIC {
        return Err(wrong("magic", String::from_utf8_lossy(&magic).escape_debug(), "GCDS"));
    }
    let version = read_u32(source)?;
    if version != VERSION {
        return Err(wrong("version", version, VERSION));
    }
    let bytes = read_u32(source)? as usize;
    let expected = read_u32(source)?;
    if bytes > MAX_HEADER || (PREFIX + bytes) as u64 > length {
        let most = MAX_HEADER.min(length as usize - PREFIX);
        return Err(wrong("header.length", bytes, format!("at most {most}")));
    }
    let mut json = vec![0; bytes];
    source.read_exact(&mut json)?;
    let found = crc(&json);
    if found != expected {
        return Err(wrong("header: CRC-32", format!("{found:08x}"), format!("{expected:08x}")));
    }
    let header: Header =
        serde_json::from_slice(&json).map_err(|e| wrong("header", e, "the header's JSON"))?;
    if header.format != FORMAT {
        return Err(wrong("header.format", header.format.escape_debug(), FORMAT));
    }
    Grid::from(header.grid).validate().map_err(|e| wrong("header.grid", e, "a grid"))?;
    let [i, n] = header.shard;
    if i >= n {
        return Err(wrong("header.shard", format!("{i} of {n}"), "a number below that of all shards"));
    }
    Ok((header, (PREFIX + bytes) as u64))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::super::sample::samples::any_sample;
    use super::super::shard::{GridHeader, record, tests::header};
    use super::*;

    fn shard(samples: &[Sample]) -> Vec<u8> {
        let grid = GridHeader { resolution: 8, size_m: 0.4 };
        let mut bytes = Header { grid, ..header() }.to_bytes();
        bytes.extend(samples.iter().flat_map(record));
        bytes
    }

    fn small() -> impl Strategy<Value = Vec<Sample>> {
        let of_eight = any_sample().prop_filter("other grid", |s| s.resolution == 8);
        prop::collection::vec(of_eight, 1..4)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn samples_come_back_in_any_order(samples in small()) {
            let mut read = Shard::open(Cursor::new(shard(&samples))).unwrap();
            prop_assert_eq!((read.len(), read.left_over()), (samples.len(), 0));
            for (i, sample) in samples.iter().enumerate().rev() {
                prop_assert_eq!(&read.read(i).unwrap(), sample);
            }
            prop_assert!(read.read(samples.len()).is_err());
            prop_assert_eq!(read.progress().unwrap(), (samples.len(), read.end()));
        }

        /// However far a run came, its whole records are found.
        #[test]
        fn a_shard_that_is_cut_off_keeps_what_is_whole(samples in small(), share in 0.0..1.0f64) {
            let all = shard(&samples);
            let start = shard(&[]).len();
            let cut = start + ((all.len() - start) as f64 * share) as usize;
            let mut read = Shard::open(Cursor::new(&all[..cut])).unwrap();
            let (count, end) = read.progress().unwrap();
            prop_assert!(count < samples.len() && end <= cut as u64);
            prop_assert_eq!(&all[..end as usize], &shard(&samples[..count])[..]);
        }

        #[test]
        fn garbled_shards_never_panic(
            samples in small(), at in any::<prop::sample::Index>(), with in any::<u32>()
        ) {
            let mut bytes = shard(&samples);
            let at = at.index(bytes.len() - 3);
            bytes[at..at + 4].copy_from_slice(&with.to_le_bytes());
            if let Ok(mut read) = Shard::open(Cursor::new(bytes)) {
                for i in 0..read.len() {
                    let _ = read.read(i);
                }
                let _ = read.progress();
            }
        }

        #[test]
        fn garbage_is_refused(mut bytes in prop::collection::vec(any::<u8>(), 0..300), magic in any::<bool>()) {
            if magic && bytes.len() >= 8 {
                bytes[..4].copy_from_slice(&MAGIC);
                bytes[4..8].copy_from_slice(&VERSION.to_le_bytes());
            }
            prop_assert!(Shard::open(Cursor::new(bytes)).is_err());
        }
    }

    #[test]
    fn a_foreign_file_and_another_version_are_named() {
        let text = |bytes: &[u8]| Shard::open(Cursor::new(bytes)).unwrap_err().to_string();
        assert_eq!(text(b"GIF89a and more bytes"), "magic: found GIF8, expected GCDS");
        let mut bytes = shard(&[]);
        bytes[4] = 9;
        assert_eq!(text(&bytes), "version: found 9, expected 1");
        assert_eq!(text(b"GCDS"), "shard: found 4 bytes, expected at least 16");
        let mut bytes = shard(&[]);
        bytes[20] ^= 1;
        assert!(text(&bytes).starts_with("header: CRC-32: found "));
    }
}
