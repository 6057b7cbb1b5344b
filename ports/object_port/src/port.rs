//! Runs commands and sends their replies.

use std::collections::HashMap;
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, PoisonError};

use futures_util::stream::{self, StreamExt};
use object_store::aws::AmazonS3;
use object_store::list::{PaginatedListOptions, PaginatedListStore};
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use serde_json::{json, Value};

use crate::command::Command;
use crate::fault::{Fault, Result};
use crate::upload::{self, Source};
use crate::{local_file, meter, ranges, settings};

const DONE: u8 = 0;
const FAILED: u8 = 1;
const PROGRESS: u8 = 2;

/// The result of a command: a JSON object and bytes.
type Reply = (Value, Vec<u8>);

/// The open buckets and the output.
#[derive(Clone)]
pub struct Port {
    buckets: Arc<Mutex<HashMap<String, AmazonS3>>>,
    out: Sender<Vec<u8>>,
}

fn split_frame(bytes: &[u8]) -> Option<(u64, &[u8], &[u8])> {
    let id = u64::from_be_bytes(bytes.get(..8)?.try_into().ok()?);
    let size = u32::from_be_bytes(bytes.get(8..12)?.try_into().ok()?) as usize;
    Some((id, bytes.get(12..12 + size)?, bytes.get(12 + size..)?))
}

fn parse_path(key: &str) -> Result<Path> {
    Ok(Path::parse(key).map_err(object_store::Error::from)?)
}

impl Port {
    pub fn new(out: Sender<Vec<u8>>) -> Port {
        Port {
            buckets: Arc::default(),
            out,
        }
    }

    /// Runs the command in a frame and sends its replies.
    pub async fn handle_frame(self, frame: Vec<u8>) {
        let Some((id, text, bytes)) = split_frame(&frame) else {
            return;
        };
        let run = async {
            let command = serde_json::from_slice(text)
                .map_err(|e| Fault::new("invalid", format!("the command is invalid: {e}")))?;
            self.run_command(id, command, bytes).await
        };
        let (result, cost) = meter::measure(run).await;
        match result {
            Ok((mut value, bytes)) => {
                value["cost"] = json!(cost);
                self.send_reply(id, DONE, &value, &bytes);
            }
            Err(fault) => {
                let mut value = json!(fault);
                value["cost"] = json!(cost);
                self.send_reply(id, FAILED, &value, &[]);
            }
        }
    }

    fn send_reply(&self, id: u64, kind: u8, value: &Value, bytes: &[u8]) {
        let text = value.to_string();
        let mut frame = id.to_be_bytes().to_vec();
        frame.push(kind);
        frame.extend((text.len() as u32).to_be_bytes());
        frame.extend(text.as_bytes());
        frame.extend(bytes);
        drop(self.out.send(frame));
    }

    fn report_progress(&self, id: u64) -> impl Fn(u64) + '_ {
        move |bytes| self.send_reply(id, PROGRESS, &json!({ "done": bytes }), &[])
    }

    fn open_bucket(&self, bucket: &str) -> Result<AmazonS3> {
        let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(store) = buckets.get(bucket) {
            return Ok(store.clone());
        }
        let store = settings::open_bucket(bucket)?;
        buckets.insert(bucket.to_owned(), store.clone());
        Ok(store)
    }

    async fn run_command(&self, id: u64, command: Command, bytes: &[u8]) -> Result<Reply> {
        match command {
            Command::Endpoint => Ok((json!({ "endpoint": settings::find_endpoint()? }), vec![])),
            Command::List {
                bucket,
                prefix,
                folders,
            } => self.list_objects(&bucket, &prefix, folders).await,
            Command::Get { bucket, key, most } => self.get_object(&bucket, &key, most).await,
            Command::Head { bucket, key } => {
                let meta = self.open_bucket(&bucket)?.head(&parse_path(&key)?).await?;
                Ok((json!({ "size": meta.size, "etag": meta.e_tag }), vec![]))
            }
            Command::Put { bucket, key } => {
                let store = self.open_bucket(&bucket)?;
                let done = store.put(&parse_path(&key)?, bytes.to_vec().into()).await?;
                Ok((json!({ "etag": done.e_tag }), vec![]))
            }
            Command::Delete { bucket, keys } => self.delete_objects(&bucket, &keys).await,
            Command::Fill(fill) => {
                let store = self.open_bucket(&fill.bucket)?;
                ranges::fill_blocks(&store, &fill, self.report_progress(id)).await?;
                Ok((json!({}), vec![]))
            }
            Command::Sums { path, block } => {
                Ok((json!({}), local_file::sum_blocks(path, block.max(1)).await?))
            }
            Command::Upload {
                bucket,
                key,
                path,
                journal,
                part,
            } => {
                let store = self.open_bucket(&bucket)?;
                let source = Source::new(&bucket, &key, &path, journal, part)?;
                let etag = upload::upload_file(&store, &source, self.report_progress(id)).await?;
                Ok((json!({ "etag": etag }), vec![]))
            }
        }
    }

    async fn list_objects(&self, bucket: &str, prefix: &str, folders: bool) -> Result<Reply> {
        let store = self.open_bucket(bucket)?;
        let (mut objects, mut names, mut page) = (Vec::new(), Vec::new(), None);
        loop {
            let options = PaginatedListOptions {
                delimiter: folders.then(|| "/".into()),
                page_token: page,
                ..PaginatedListOptions::default()
            };
            let wanted = (!prefix.is_empty()).then_some(prefix);
            let found = store.list_paginated(wanted, options).await?;
            for meta in found.result.objects {
                let key = meta.location.to_string();
                objects.push(json!({ "key": key, "size": meta.size, "etag": meta.e_tag }));
            }
            let prefixes = found.result.common_prefixes.iter();
            names.extend(prefixes.map(ToString::to_string));
            page = found.page_token;
            if page.is_none() {
                return Ok((json!({ "objects": objects, "folders": names }), vec![]));
            }
        }
    }

    async fn get_object(&self, bucket: &str, key: &str, most: u64) -> Result<Reply> {
        let result = self.open_bucket(bucket)?.get(&parse_path(key)?).await?;
        if result.meta.size > most {
            let why = format!(
                "{key} has {} bytes, and at most {most} are allowed",
                result.meta.size
            );
            return Err(Fault::new("invalid", why));
        }
        let about = json!({ "etag": result.meta.e_tag });
        Ok((about, ranges::collect_body(result).await?))
    }

    async fn delete_objects(&self, bucket: &str, keys: &[String]) -> Result<Reply> {
        if keys.is_empty() {
            return Ok((json!({}), vec![]));
        }
        let store = self.open_bucket(bucket)?;
        let paths = keys.iter().map(|key| parse_path(key));
        let paths = paths.collect::<Result<Vec<Path>>>()?;
        let mut deletions = store.delete_stream(stream::iter(paths.into_iter().map(Ok)).boxed());
        while let Some(result) = deletions.next().await {
            match result {
                Ok(_) | Err(object_store::Error::NotFound { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok((json!({}), vec![]))
    }
}
