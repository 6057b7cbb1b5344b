//! Fonts from files, kept as long as the files stay the same.

use crate::error::{fail, Code, Result};
use skrifa::font::Font;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

/// The largest fonts of whole scripts have 20 MB.
const MAX_BYTES: u64 = 64 << 20;

/// Fonts in memory at a time; the one unused longest goes.
const KEPT: usize = 8;

#[derive(Clone, PartialEq, Eq)]
struct Stamp {
    path: PathBuf,
    bytes: u64,
    modified: Option<SystemTime>,
}

static LIBRARY: Mutex<Vec<(Stamp, Font)>> = Mutex::new(Vec::new());

/// The first font in a TrueType or OpenType file or collection.
pub fn open(path: &Path) -> Result<Font> {
    let stamp = stamp(path)?;
    if let Some(font) = kept(&stamp) {
        return Ok(font);
    }
    let font = parse(read(path)?, path)?;
    let mut library = LIBRARY.lock().unwrap_or_else(PoisonError::into_inner);
    library.retain(|(other, _)| other.path != stamp.path);
    library.truncate(KEPT - 1);
    library.insert(0, (stamp, font.clone()));
    Ok(font)
}

fn kept(stamp: &Stamp) -> Option<Font> {
    let mut library = LIBRARY.lock().unwrap_or_else(PoisonError::into_inner);
    let at = library.iter().position(|(other, _)| other == stamp)?;
    library[..=at].rotate_right(1);
    Some(library[0].1.clone())
}

fn stamp(path: &Path) -> Result<Stamp> {
    let about = std::fs::metadata(path).or_else(|e| unreadable(path, e))?;
    // A pipe or a device would be waited for.
    if !about.is_file() {
        return fail(Code::BadFont, format!("{}: not a file", path.display()));
    }
    Ok(Stamp {
        path: path.to_path_buf(),
        bytes: about.len(),
        modified: about.modified().ok(),
    })
}

fn read(path: &Path) -> Result<Vec<u8>> {
    let file = File::open(path).or_else(|e| unreadable(path, e))?;
    let mut bytes = Vec::new();
    file.take(MAX_BYTES + 1)
        .read_to_end(&mut bytes)
        .or_else(|e| unreadable(path, e))?;
    if bytes.len() as u64 > MAX_BYTES {
        let what = format!("{}: larger than {MAX_BYTES} bytes", path.display());
        return fail(Code::BadFont, what);
    }
    Ok(bytes)
}

fn unreadable<T>(path: &Path, error: std::io::Error) -> Result<T> {
    fail(Code::BadFont, format!("{}: {error}", path.display()))
}

fn parse(bytes: Vec<u8>, path: &Path) -> Result<Font> {
    let font = super::sound(|| Font::new(bytes, 0))?;
    match font {
        Some(font) if !font.outline_glyphs().is_empty() && font.charmap().has_unicode() => Ok(font),
        _ => fail(
            Code::BadFont,
            format!(
                "{}: not a TrueType or OpenType font with outlines",
                path.display()
            ),
        ),
    }
}
