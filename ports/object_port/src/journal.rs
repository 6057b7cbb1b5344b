//! Remembers the parts of an upload in a local file, one line each, so that it can continue after a break.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write;

use serde::{Deserialize, Serialize};

use crate::fault::{Fault, Result};

/// The uploaded file. A journal of another version of the file is not used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    pub endpoint: String,
    pub bucket: String,
    pub key: String,
    pub size: u64,
    pub modified: u128,
    pub part: u64,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Begin { subject: Subject, upload: String },
    Part { index: usize, etag: String },
}

/// An upload with its parts so far.
#[derive(Debug)]
pub struct Journal {
    path: String,
    file: Option<File>,
    /// The service's name for the upload.
    pub upload: String,
    /// The parts that the service has, by index.
    pub parts: BTreeMap<usize, String>,
}

impl Journal {
    /// Returns the journal of an earlier upload of the same file, or `None`. An incomplete last line is ignored.
    pub fn find(path: &str, subject: &Subject) -> Option<Journal> {
        let text = std::fs::read_to_string(path).ok()?;
        let mut lines = text
            .lines()
            .map_while(|line| serde_json::from_str(line).ok());
        let Some(Line::Begin {
            subject: old,
            upload,
        }) = lines.next()
        else {
            return None;
        };
        if old != *subject {
            return None;
        }
        let mut parts = BTreeMap::new();
        for line in lines {
            if let Line::Part { index, etag } = line {
                parts.insert(index, etag);
            }
        }
        let file = OpenOptions::new().append(true).open(path).ok();
        Some(Journal {
            path: path.to_owned(),
            file,
            upload,
            parts,
        })
    }

    /// Creates the journal of a new upload.
    pub fn create(path: &str, subject: &Subject, upload: String) -> Result<Journal> {
        let file = File::create(path).map_err(|e| Fault::local("create", path, &e))?;
        let mut journal = Journal {
            path: path.to_owned(),
            file: Some(file),
            upload: upload.clone(),
            parts: BTreeMap::new(),
        };
        journal.write_line(&Line::Begin {
            subject: subject.clone(),
            upload,
        })?;
        Ok(journal)
    }

    /// Adds a part that the service has received.
    pub fn add_part(&mut self, index: usize, etag: String) -> Result<()> {
        self.write_line(&Line::Part {
            index,
            etag: etag.clone(),
        })?;
        self.parts.insert(index, etag);
        Ok(())
    }

    /// Deletes the journal of an upload that has ended.
    pub fn remove(self) {
        let _ = std::fs::remove_file(&self.path);
    }

    fn write_line(&mut self, line: &Line) -> Result<()> {
        let text = serde_json::to_string(line).map_err(|e| Fault::new("failed", e.to_string()))?;
        let Some(file) = self.file.as_mut() else {
            return Ok(());
        };
        file.write_all(format!("{text}\n").as_bytes())
            .map_err(|e| Fault::local("write", &self.path, &e))
    }
}
