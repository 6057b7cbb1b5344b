//! The schemas and channels that a new file has, under the numbers of the original.

use std::collections::BTreeSet;

use crate::{Channel, Error, Result, Schema, Writer};

#[derive(Default)]
pub struct Described {
    schemas: BTreeSet<u16>,
    pub channels: BTreeSet<u16>,
}

impl Described {
    /// Writes a schema; the first one of a number counts.
    pub fn schema(&mut self, writer: &mut Writer, id: u16, schema: &Schema) -> Result<()> {
        if !self.schemas.insert(id) {
            return Ok(());
        }
        let inner = writer.inner()?;
        inner
            .add_schema_with_id(id, &schema.name, &schema.encoding, &schema.data)
            .map(|_| ())
            .map_err(|e| Error::mcap("write", e))
    }

    /// Writes a channel; the first one of a number counts.
    pub fn channel(&mut self, writer: &mut Writer, channel: &Channel) -> Result<()> {
        let schema = channel.schema;
        if schema != 0 && !self.schemas.contains(&schema) {
            let topic = &channel.topic;
            let why = format!("the schema {schema} of {topic:?} is not in the file");
            return Err(Error::Damaged(0, why));
        }
        if !self.channels.insert(channel.id) {
            return Ok(());
        }
        let (topic, encoding) = (&channel.topic, &channel.encoding);
        let inner = writer.inner()?;
        inner
            .add_channel_with_id(channel.id, schema, topic, encoding, &channel.metadata)
            .map(|_| ())
            .map_err(|e| Error::mcap("write", e))
    }
}
