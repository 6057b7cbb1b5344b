//! Writes the schemas and channels of a new file under the numbers of the original.

use std::collections::BTreeSet;

use crate::{Channel, Error, Result, Schema, Writer};

#[derive(Default)]
pub struct Definitions {
    schemas: BTreeSet<u16>,
    pub channels: BTreeSet<u16>,
}

impl Definitions {
    /// Writes a schema, unless one with this number was written before.
    pub fn write_schema(&mut self, writer: &mut Writer, id: u16, schema: &Schema) -> Result<()> {
        if !self.schemas.insert(id) {
            return Ok(());
        }
        let inner = writer.inner()?;
        inner
            .add_schema_with_id(id, &schema.name, &schema.encoding, &schema.data)
            .map(|_| ())
            .map_err(|e| Error::mcap("write", e))
    }

    /// Writes a channel, unless one with this number was written before.
    pub fn write_channel(&mut self, writer: &mut Writer, channel: &Channel) -> Result<()> {
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
