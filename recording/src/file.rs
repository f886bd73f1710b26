//! One MCAP file that is being written.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};

use crate::schema::{Bundle, Schema};

/// Written into the header of each file.
const LIBRARY: &str = concat!("graspd ", env!("CARGO_PKG_VERSION"));
/// Topics of one file; those of more cameras or tasks than any call has are not written.
const MOST_TOPICS: usize = 4096;

/// A file that is open.
pub(crate) struct FileWriter {
    writer: Writer<BufWriter<File>>,
    schemas: HashMap<Schema, u16>,
    channels: HashMap<(String, Schema), u16>,
}

impl FileWriter {
    /// Begins a file that must not exist.
    pub(crate) fn create(path: &Path) -> io::Result<Self> {
        let file = File::options().write(true).create_new(true).open(path)?;
        let options = WriteOptions::new()
            .library(LIBRARY)
            .compression(None)
            // A chunk is a bundle: `write` ends each.
            .chunk_size(None)
            // A chunk goes to the disk in one piece when it is whole.
            .disable_seeking(true);
        let writer = options.create(BufWriter::new(file)).map_err(io_error)?;
        Ok(Self { writer, schemas: HashMap::new(), channels: HashMap::new() })
    }

    /// Writes a bundle and hands it to the system.
    pub(crate) fn write(&mut self, sequence: u32, bundle: &Bundle) -> io::Result<()> {
        for message in &bundle.messages {
            let key = (message.topic.clone(), message.schema);
            let channel_id = match self.channels.get(&key) {
                Some(id) => *id,
                None if self.channels.len() >= MOST_TOPICS => continue,
                None => {
                    let id = self.channel(&message.topic, message.schema)?;
                    self.channels.insert(key, id);
                    id
                }
            };
            let time = bundle.time_ns;
            let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
            self.writer.write_to_known_channel(&header, &message.data).map_err(io_error)?;
        }
        self.writer.flush().map_err(io_error)
    }

    /// Writes the index and ends the file.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.writer.finish().map_err(io_error)?;
        io::Write::flush(&mut self.writer.into_inner())
    }

    fn channel(&mut self, topic: &str, schema: Schema) -> io::Result<u16> {
        let schema_id = match self.schemas.get(&schema) {
            Some(id) => *id,
            None => {
                let added = self.writer.add_schema(schema.name(), "protobuf", &schema.descriptors());
                let id = added.map_err(io_error)?;
                self.schemas.insert(schema, id);
                id
            }
        };
        self.writer.add_channel(schema_id, topic, "protobuf", &Default::default()).map_err(io_error)
    }
}

impl std::fmt::Debug for FileWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileWriter").field("channels", &self.channels.len()).finish_non_exhaustive()
    }
}

fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
