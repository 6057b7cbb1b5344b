//! Reads and writes parts of local files outside the tasks that wait for the network.

use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use crate::fault::{Fault, Result};

/// The marks of a mirror begin at a multiple of this.
const PAGE: u64 = 4096;

async fn run_blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> Result<T> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|e| Fault::new("failed", e.to_string()))?
}

/// Reads `length` bytes at `offset`.
pub async fn read_part(path: &str, offset: u64, length: usize) -> Result<Vec<u8>> {
    let path = path.to_owned();
    run_blocking(move || {
        let mut bytes = vec![0; length];
        File::open(&path)
            .and_then(|file| file.read_exact_at(&mut bytes, offset))
            .map_err(|e| Fault::local("read", &path, &e))?;
        Ok(bytes)
    })
    .await
}

/// A local mirror of an object. Its file stays the same if another program replaces it.
#[derive(Debug, Clone)]
pub struct Mirror {
    file: Arc<File>,
    path: String,
    table: u64,
}

impl Mirror {
    /// Opens a mirror of an object of `size` bytes.
    pub fn open(path: &str, size: u64) -> Result<Mirror> {
        let file = OpenOptions::new().read(true).write(true).open(path);
        Ok(Mirror {
            file: Arc::new(file.map_err(|e| Fault::local("open", path, &e))?),
            path: path.to_owned(),
            table: size.next_multiple_of(PAGE),
        })
    }

    /// Reads the marks of all blocks.
    pub fn read_marks(&self, count: u64) -> Result<Vec<u8>> {
        let mut marks = vec![0; count as usize];
        self.file
            .read_exact_at(&mut marks, self.table)
            .map_err(|e| Fault::local("read", &self.path, &e))?;
        Ok(marks)
    }

    /// Writes bytes at `offset`, and marks their blocks from `first` on after the bytes are on disk. If the process is
    /// killed, no block is marked that was not written.
    pub async fn write_blocks(
        &self,
        offset: u64,
        bytes: Vec<u8>,
        first: u64,
        count: u64,
    ) -> Result<()> {
        let mirror = self.clone();
        run_blocking(move || {
            let file = &mirror.file;
            file.write_all_at(&bytes, offset)
                .and_then(|()| file.sync_data())
                .and_then(|()| file.write_all_at(&vec![1; count as usize], mirror.table + first))
                .map_err(|e| Fault::local("write", &mirror.path, &e))
        })
        .await
    }
}

/// Returns the CRC-32 of each block of a file.
pub async fn sum_blocks(path: String, block: u64) -> Result<Vec<u8>> {
    run_blocking(move || {
        let failed = |e: &std::io::Error| Fault::local("read", &path, e);
        let mut file = File::open(&path).map_err(|e| failed(&e))?;
        let mut sums = Vec::new();
        loop {
            let mut bytes = Vec::with_capacity(block as usize);
            let read = file.by_ref().take(block).read_to_end(&mut bytes);
            if read.map_err(|e| failed(&e))? == 0 {
                return Ok(sums);
            }
            sums.extend(crc32fast::hash(&bytes).to_le_bytes());
        }
    })
    .await
}
