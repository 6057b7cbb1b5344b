//! Reads the points of LAS and LAZ files.
//!
//! Records are decompressed with the crate `laz`, which trusts the sizes in a file, so they are checked first.

use std::io::Cursor;
use std::panic::{catch_unwind, AssertUnwindSafe};

use laz::{LasZipDecompressor, LazItemType, LazVlr};

use crate::error::{fail, Code, Result};

/// The maximum size of the decompressed records.
const MAX_BYTES: usize = 4_000_000_000;

/// The position and size of the records in a file.
#[derive(Clone, Copy, Debug)]
pub struct Records {
    /// The offset of the compressed records, which begin with the offset of the chunk table.
    pub at: usize,
    /// The bytes of a decompressed record.
    pub size: usize,
    /// The number of records.
    pub count: usize,
}

/// Decompresses the records of a LAZ file. `packing` is the data of its variable length record "laszip encoded".
pub fn unpack_records(file: &[u8], records: Records, packing: &[u8]) -> Result<Vec<u8>> {
    let Ok(vlr) = LazVlr::from_buffer(packing) else {
        return fail_file("the record that describes its compression is invalid");
    };
    let items: usize = vlr
        .items()
        .iter()
        .map(|item| usize::from(item.size()))
        .sum();
    let bytes = records.count.checked_mul(records.size);
    let bytes = match bytes {
        Some(bytes) if vlr.items().is_empty() || items != records.size || bytes > MAX_BYTES => None,
        bytes => bytes,
    };
    let Some(bytes) = bytes else {
        return fail_file("the size of its records differs from that in its header");
    };
    if records.count == 0 {
        return Ok(Vec::new());
    }
    check_chunk_table(file, records)?;
    if is_layered(&vlr) {
        check_layers(file, records, &vlr)?;
    }
    let mut out = Vec::new();
    if out.try_reserve_exact(bytes).is_err() {
        return fail(Code::TooLarge, format!("no memory for {bytes} bytes"));
    }
    out.resize(bytes, 0);
    let mut source = Cursor::new(file);
    source.set_position(records.at as u64);
    let unpacked = catch_unwind(AssertUnwindSafe(|| {
        LasZipDecompressor::new(source, vlr)
            .and_then(|mut from| Ok(from.decompress_many(&mut out)?))
            .is_ok()
    }));
    match unpacked {
        Ok(true) => Ok(out),
        _ => fail_file("its compressed points are damaged or truncated"),
    }
}

fn fail_file<T>(what: &str) -> Result<T> {
    fail(Code::BadCloud, what)
}

fn read_u32(file: &[u8], at: usize) -> Option<usize> {
    let bytes = file.get(at..at.checked_add(4)?)?;
    usize::try_from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])).ok()
}

fn read_offset(file: &[u8], at: usize) -> Option<usize> {
    let bytes: [u8; 8] = file.get(at..at.checked_add(8)?)?.try_into().ok()?;
    usize::try_from(i64::from_le_bytes(bytes)).ok()
}

// A table with more chunks than the file can contain would allocate too much memory.
fn check_chunk_table(file: &[u8], records: Records) -> Result<()> {
    let tables = [
        read_offset(file, records.at),
        read_offset(file, file.len().saturating_sub(8)),
    ];
    for table in tables.into_iter().flatten() {
        let chunks = table.checked_add(4).and_then(|at| read_u32(file, at));
        if table > records.at && chunks.is_some_and(|n| n > file.len() / records.size.max(1)) {
            return fail_file("its chunk table is damaged");
        }
    }
    Ok(())
}

// The version of the items determines how the crate reads chunks.
fn is_layered(vlr: &LazVlr) -> bool {
    vlr.items().iter().any(|item| item.version() > 2)
}

fn count_layers(item: LazItemType) -> usize {
    match item {
        LazItemType::Point14 => 9,
        LazItemType::RGB14 | LazItemType::WavePacket14 => 1,
        LazItemType::RGBNIR14 => 2,
        LazItemType::Byte14(count) => usize::from(count),
        _ => 0,
    }
}

// A chunk consists of its first record, the number of its records, the sizes of its layers, and the layers.
fn check_layers(file: &[u8], records: Records, vlr: &LazVlr) -> Result<()> {
    let layers: usize = vlr
        .items()
        .iter()
        .map(|i| count_layers(i.item_type()))
        .sum();
    let (mut at, mut seen) = (records.at.saturating_add(8), 0usize);
    while seen < records.count {
        let head = at.saturating_add(records.size);
        let Some(count) = read_u32(file, head).filter(|count| *count > 0) else {
            return fail_file("a chunk of its points is truncated");
        };
        let mut end = head + 4 + 4 * layers;
        for layer in 0..layers {
            end = end.saturating_add(read_u32(file, head + 4 + 4 * layer).unwrap_or(usize::MAX));
        }
        if end > file.len() {
            return fail_file("a chunk of its points is truncated");
        }
        (at, seen) = (end, seen.saturating_add(count));
    }
    Ok(())
}

/// Returns the positions of the records (three integers, multiplied by `scale`, plus `offset`) as points, their
/// colors, and their intensities as 32-bit floats. Colors begin at the offset `colors` of a record and have 16 bits
/// each, of which many writers use only the lower 8. Colors and intensities are empty if the file has none.
pub fn read_cloud(
    records: &[u8],
    size: usize,
    colors: Option<usize>,
    scale: [f64; 3],
    offset: [f64; 3],
) -> Result<(Vec<u8>, Vec<u8>, Vec<u8>)> {
    if size < 14 || !records.len().is_multiple_of(size) || colors.is_some_and(|at| at + 6 > size) {
        return fail_file("the size of its records differs from that in its header");
    }
    let count = records.len() / size;
    let mut points = Vec::with_capacity(count * 12);
    let (mut tones, mut intensities) = (Vec::new(), Vec::new());
    let tone = |record: &[u8], at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
    let most = colors.map_or(0, |at| {
        let of = |r: &[u8]| (0..3).map(|k| tone(r, at + 2 * k)).max().unwrap_or(0);
        records.chunks_exact(size).map(of).max().unwrap_or(0)
    });
    let has_intensity = records.chunks_exact(size).any(|r| tone(r, 12) > 0);
    for record in records.chunks_exact(size) {
        if has_intensity {
            intensities.extend_from_slice(&f32::from(tone(record, 12)).to_le_bytes());
        }
        for axis in 0..3 {
            let at = 4 * axis;
            let whole = [record[at], record[at + 1], record[at + 2], record[at + 3]];
            let value = f64::from(i32::from_le_bytes(whole)) * scale[axis] + offset[axis];
            if !(value as f32).is_finite() {
                return fail_file("its points are outside the range of 32-bit floats");
            }
            points.extend_from_slice(&(value as f32).to_le_bytes());
        }
        if let (Some(at), true) = (colors, most > 0) {
            let shift = if most > 255 { 8 } else { 0 };
            tones.extend((0..3).map(|k| (tone(record, at + 2 * k) >> shift) as u8));
        }
    }
    Ok((points, tones, intensities))
}

#[cfg(test)]
mod tests {
    use super::*;
    use laz::{LasZipCompressor, LazItemRecordBuilder};

    // Returns the compressed records of a format, in a file with a header of 40 bytes.
    fn pack_records(format: u8, count: usize) -> (Vec<u8>, Records, Vec<u8>, Vec<u8>) {
        let items =
            LazItemRecordBuilder::default_for_point_format_id(format, 0).unwrap_or_default();
        let size = items.iter().map(|i| usize::from(i.size())).sum();
        let mut records = Vec::new();
        for i in 0..count {
            let mut record = vec![0u8; size];
            record[..4].copy_from_slice(&(i as i32 * 3).to_le_bytes());
            record[4..8].copy_from_slice(&(-(i as i32)).to_le_bytes());
            records.extend_from_slice(&record);
        }
        let mut file = Cursor::new(vec![7u8; 40]);
        file.set_position(40);
        let mut vlr = Vec::new();
        if let Ok(mut packer) = LasZipCompressor::from_laz_items(&mut file, items) {
            let done = packer.compress_many(&records).is_ok() && packer.done().is_ok();
            assert!(done && packer.vlr().write_to(&mut vlr).is_ok());
        }
        let position = Records {
            at: 40,
            size,
            count,
        };
        (file.into_inner(), position, vlr, records)
    }

    #[test]
    fn compressed_records_are_decompressed() {
        for format in [0, 1, 2, 3, 6, 7, 8] {
            let (file, position, vlr, records) = pack_records(format, 60_000);
            assert!(file.len() < records.len());
            assert_eq!(
                unpack_records(&file, position, &vlr),
                Ok(records),
                "format {format}"
            );
        }
    }

    #[test]
    fn damaged_files_are_errors_and_allocate_no_memory() {
        for format in [3, 7] {
            let (file, position, vlr, _) = pack_records(format, 300);
            assert!(unpack_records(&file[..200], position, &vlr).is_err());
            assert!(unpack_records(&file, position, &vlr[..10]).is_err());
            let more = Records {
                count: usize::MAX / 64,
                ..position
            };
            assert!(unpack_records(&file, more, &vlr).is_err());
            // Damages every byte once, which must not panic or allocate gigabytes.
            for at in 40..file.len().min(250) {
                let mut torn = file.clone();
                torn[at] ^= 0xff;
                let _ = unpack_records(&torn, position, &vlr);
            }
            for at in 0..vlr.len() {
                let mut torn = vlr.clone();
                torn[at] ^= 0xff;
                let _ = unpack_records(&file, position, &torn);
            }
        }
    }

    #[test]
    fn positions_are_scaled_and_colors_converted_to_bytes() {
        let mut record = Vec::new();
        record.extend_from_slice(&100i32.to_le_bytes());
        record.extend_from_slice(&(-50i32).to_le_bytes());
        record.extend_from_slice(&7i32.to_le_bytes());
        record.extend_from_slice(&[7, 1]);
        record.extend_from_slice(&[0, 255, 0, 1, 255, 0]);
        let (points, tones, intensities) =
            read_cloud(&record, 20, Some(14), [0.5; 3], [1.0, 0.0, 0.0]).unwrap_or_default();
        let expected: Vec<u8> = [51.0f32, -25.0, 3.5]
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        assert_eq!((points, tones), (expected, vec![255, 1, 0]));
        assert_eq!(intensities, 263f32.to_le_bytes());
        assert!(read_cloud(&record, 19, None, [1.0; 3], [0.0; 3]).is_err());
        assert!(read_cloud(&record, 20, None, [f64::MAX; 3], [0.0; 3]).is_err());
    }
}
