//! Loads fonts from files and caches them until the files change.

use crate::error::{fail, Code, Result};
use skrifa::font::Font;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

/// The largest fonts for CJK scripts have metadata 20 MB.
const MAX_BYTES: u64 = 64 << 20;

/// The maximum number of cached fonts; the least recently used font is evicted.
const MAX_FONTS: usize = 8;

#[derive(Clone, PartialEq, Eq)]
struct Stamp {
    path: PathBuf,
    bytes: u64,
    modified: Option<SystemTime>,
}

static CACHE: Mutex<Vec<(Stamp, Font)>> = Mutex::new(Vec::new());

/// Opens the first font of a TrueType or OpenType file or collection.
pub fn open_font(path: &Path) -> Result<Font> {
    let stamp = file_stamp(path)?;
    if let Some(font) = find_cached(&stamp) {
        return Ok(font);
    }
    let font = parse_font(read_font(path)?, path)?;
    let mut cache = CACHE.lock().unwrap_or_else(PoisonError::into_inner);
    cache.retain(|(other, _)| other.path != stamp.path);
    cache.truncate(MAX_FONTS - 1);
    cache.insert(0, (stamp, font.clone()));
    Ok(font)
}

fn find_cached(stamp: &Stamp) -> Option<Font> {
    let mut cache = CACHE.lock().unwrap_or_else(PoisonError::into_inner);
    let at = cache.iter().position(|(other, _)| other == stamp)?;
    cache[..=at].rotate_right(1);
    Some(cache[0].1.clone())
}

fn file_stamp(path: &Path) -> Result<Stamp> {
    let metadata = std::fs::metadata(path).or_else(|e| read_error(path, e))?;
    // Reading a pipe or a device could block.
    if !metadata.is_file() {
        return fail(Code::BadFont, format!("{}: not a file", path.display()));
    }
    Ok(Stamp {
        path: path.to_path_buf(),
        bytes: metadata.len(),
        modified: metadata.modified().ok(),
    })
}

fn read_font(path: &Path) -> Result<Vec<u8>> {
    let file = File::open(path).or_else(|e| read_error(path, e))?;
    let mut bytes = Vec::new();
    file.take(MAX_BYTES + 1)
        .read_to_end(&mut bytes)
        .or_else(|e| read_error(path, e))?;
    if bytes.len() as u64 > MAX_BYTES {
        let what = format!("{}: larger than {MAX_BYTES} bytes", path.display());
        return fail(Code::BadFont, what);
    }
    Ok(bytes)
}

fn read_error<T>(path: &Path, error: std::io::Error) -> Result<T> {
    fail(Code::BadFont, format!("{}: {error}", path.display()))
}

fn parse_font(bytes: Vec<u8>, path: &Path) -> Result<Font> {
    let font = super::catch_font_panic(|| Font::new(bytes, 0))?;
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
