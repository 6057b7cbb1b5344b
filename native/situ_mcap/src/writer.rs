//! Writes a file.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use mcap::records::{MessageHeader, Metadata};

use crate::{Error, Result};

const BUFFER: usize = 256 << 10;

/// The compression of chunks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// No compression.
    None,
    /// LZ4.
    Lz4,
    /// Zstandard.
    Zstd,
}

/// The description of a channel to write.
pub struct ChannelSpec<'a> {
    /// Its name.
    pub topic: &'a str,
    /// The encoding of its messages.
    pub encoding: &'a str,
    /// The type's name, the language of its definition, and the definition; `None` for no schema.
    pub schema: Option<(&'a str, &'a str, &'a [u8])>,
    /// Further metadata.
    pub metadata: BTreeMap<String, String>,
}

/// The options of a new file.
pub struct Options<'a> {
    /// Its profile, such as `ros1`.
    pub profile: &'a str,
    /// The name of the library that writes it; `None` for Situ.
    pub library: Option<&'a str>,
    /// The compression of its chunks.
    pub compression: Compression,
    /// The size of a chunk before compression, bytes; `None` for messages without chunks.
    pub chunk: Option<u64>,
}

/// An MCAP file that is being written. Flushed messages stay readable even if the writer dies.
pub struct Writer {
    inner: Option<mcap::Writer<BufWriter<File>>>,
}

impl Writer {
    /// Creates a file, replacing an existing one.
    pub fn create(path: &Path, options: &Options) -> Result<Self> {
        let file = File::create(path).map_err(|e| Error::io("create", &e))?;
        let compression = match options.compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        };
        let situ = concat!("situ/", env!("CARGO_PKG_VERSION"));
        let write = mcap::WriteOptions::new()
            .profile(options.profile)
            .library(options.library.unwrap_or(situ))
            .compression(compression)
            .compression_threads(0)
            .use_chunks(options.chunk.is_some())
            .chunk_size(options.chunk);
        let inner = write
            .create(BufWriter::with_capacity(BUFFER, file))
            .map_err(|e| Error::mcap("begin", e))?;
        Ok(Writer { inner: Some(inner) })
    }

    pub(crate) fn inner(&mut self) -> Result<&mut mcap::Writer<BufWriter<File>>> {
        self.inner.as_mut().ok_or(Error::Closed)
    }

    /// Adds a channel and returns its number.
    pub fn add_channel(&mut self, spec: &ChannelSpec) -> Result<u16> {
        let inner = self.inner()?;
        let schema = match spec.schema {
            Some((name, encoding, data)) => inner
                .add_schema(name, encoding, data)
                .map_err(|e| Error::mcap("write", e))?,
            None => 0,
        };
        inner
            .add_channel(schema, spec.topic, spec.encoding, &spec.metadata)
            .map_err(|e| Error::mcap("write", e))
    }

    /// Appends a message.
    pub fn write_message(
        &mut self,
        channel: u16,
        sequence: u32,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> Result<()> {
        let header = MessageHeader {
            channel_id: channel,
            sequence,
            log_time,
            publish_time,
        };
        self.inner()?
            .write_to_known_channel(&header, data)
            .map_err(|e| Error::mcap("write", e))
    }

    /// Appends an attachment, which was recorded and created at `times`.
    pub fn write_attachment(
        &mut self,
        name: &str,
        media_type: &str,
        times: (u64, u64),
        data: &[u8],
    ) -> Result<()> {
        let attachment = mcap::Attachment {
            log_time: times.0,
            create_time: times.1,
            name: name.to_string(),
            media_type: media_type.to_string(),
            data: Cow::Borrowed(data),
        };
        self.inner()?
            .attach(&attachment)
            .map_err(|e| Error::mcap("write", e))
    }

    /// Appends a metadata record.
    pub fn write_metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<()> {
        let metadata = Metadata {
            name: name.to_string(),
            metadata,
        };
        self.inner()?
            .write_metadata(&metadata)
            .map_err(|e| Error::mcap("write", e))
    }

    /// Ends the chunk and passes it to the operating system, so that readers find everything written so far.
    pub fn flush(&mut self) -> Result<()> {
        self.inner()?.flush().map_err(|e| Error::mcap("write", e))
    }

    /// Writes the index and the footer. Nothing can be written afterwards.
    pub fn finish(&mut self) -> Result<()> {
        let mut inner = self.inner.take().ok_or(Error::Closed)?;
        inner.finish().map_err(|e| Error::mcap("finish", e))?;
        let file = inner
            .into_inner()
            .into_inner()
            .map_err(|e| Error::io("finish", e.error()))?;
        file.sync_data().map_err(|e| Error::io("sync", &e))
    }
}
