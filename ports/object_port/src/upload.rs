//! Uploads a local file, large ones in parts. A signature covers the SHA-256 of each part, so the service rejects
//! bytes that changed on the way.

use std::time::UNIX_EPOCH;

use futures_util::stream::{self, StreamExt, TryStreamExt};
use object_store::aws::AmazonS3;
use object_store::multipart::{MultipartStore, PartId};
use object_store::path::Path;
use object_store::ObjectStoreExt;

use crate::fault::{Fault, Result};
use crate::journal::{Journal, Subject};
use crate::{local_file, settings};

/// The number of parts at the same time.
const PARALLEL: usize = 4;
/// The maximum number of parts that a service accepts is 10,000.
const MOST_PARTS: u64 = 9_000;
/// Parts are at least this large, except the last one.
const SMALLEST_PART: u64 = 5 << 20;

/// A file to upload.
pub struct Source {
    pub key: Path,
    pub path: String,
    pub journal: String,
    size: u64,
    subject: Subject,
}

impl Source {
    /// Examines the file. `part` is the wanted size of parts.
    pub fn new(bucket: &str, key: &str, path: &str, journal: String, part: u64) -> Result<Source> {
        let about = std::fs::metadata(path).map_err(|e| Fault::local("read", path, &e))?;
        let size = about.len();
        let modified = about.modified().ok();
        let modified = modified.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let part = part.max(SMALLEST_PART).max(size.div_ceil(MOST_PARTS));
        let subject = Subject {
            endpoint: settings::find_endpoint()?,
            bucket: bucket.to_owned(),
            key: key.to_owned(),
            size,
            modified: modified.map_or(0, |time| time.as_nanos()),
            part,
        };
        Ok(Source {
            key: Path::parse(key).map_err(object_store::Error::from)?,
            path: path.to_owned(),
            journal,
            size,
            subject,
        })
    }

    fn part_length(&self, index: usize) -> u64 {
        let start = index as u64 * self.subject.part;
        (self.size - start.min(self.size)).min(self.subject.part)
    }
}

/// Uploads the file and returns the object's version. Passes the number of uploaded bytes to `progress`; parts that
/// were uploaded before a break count, too.
pub async fn upload_file(
    store: &AmazonS3,
    source: &Source,
    progress: impl Fn(u64),
) -> Result<Option<String>> {
    if source.size <= source.subject.part {
        let bytes = local_file::read_part(&source.path, 0, source.size as usize).await?;
        store.put(&source.key, bytes.into()).await?;
        progress(source.size);
        return check_object(store, source).await;
    }
    if let Some(journal) = Journal::find(&source.journal, &source.subject) {
        match upload_parts(store, source, journal, &progress).await {
            // The service has discarded the parts, so the upload starts again.
            Err(fault) if fault.code == "not_found" => {}
            other => return other,
        }
    }
    let upload = store.create_multipart(&source.key).await?;
    let journal = Journal::create(&source.journal, &source.subject, upload)?;
    upload_parts(store, source, journal, &progress).await
}

/// Checks the size of the new object, and returns the version that readers get.
async fn check_object(store: &AmazonS3, source: &Source) -> Result<Option<String>> {
    let meta = store.head(&source.key).await?;
    if meta.size != source.size {
        let why = format!(
            "the object has {} bytes, but {} has {}",
            meta.size, source.path, source.size
        );
        return Err(Fault::new("checksum", why));
    }
    Ok(meta.e_tag)
}

async fn upload_parts(
    store: &AmazonS3,
    source: &Source,
    mut journal: Journal,
    progress: &impl Fn(u64),
) -> Result<Option<String>> {
    let count = source.size.div_ceil(source.subject.part) as usize;
    let missing: Vec<usize> = (0..count)
        .filter(|i| !journal.parts.contains_key(i))
        .collect();
    let before: u64 = journal.parts.keys().map(|i| source.part_length(*i)).sum();
    if before > 0 {
        progress(before);
    }
    let upload = journal.upload.clone();
    let mut parts = stream::iter(missing)
        .map(|index| put_part(store, source, &upload, index))
        .buffer_unordered(PARALLEL);
    while let Some((index, etag)) = parts.try_next().await? {
        progress(source.part_length(index));
        journal.add_part(index, etag)?;
    }
    drop(parts);
    let ids = journal.parts.values().map(|etag| PartId {
        content_id: etag.clone(),
    });
    store
        .complete_multipart(&source.key, &upload, ids.collect())
        .await?;
    journal.remove();
    check_object(store, source).await
}

async fn put_part(
    store: &AmazonS3,
    source: &Source,
    upload: &String,
    index: usize,
) -> Result<(usize, String)> {
    let (offset, length) = (
        index as u64 * source.subject.part,
        source.part_length(index),
    );
    let bytes = local_file::read_part(&source.path, offset, length as usize).await?;
    let id = store
        .put_part(&source.key, upload, index, bytes.into())
        .await?;
    Ok((index, id.content_id))
}
