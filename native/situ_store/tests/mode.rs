#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
//! The file modes of a recording. There is only one test, because the mode mask belongs to the process.
mod common;

use std::os::unix::fs::PermissionsExt;

use common::*;
use rustix::fs::Mode;
use rustix::process::umask;
use situ_store::{repair, Options, Writer};

fn file_modes(folder: &Folder) -> Vec<u32> {
    let entries = std::fs::read_dir(&folder.0).unwrap();
    let mode = |entry: std::fs::DirEntry| entry.metadata().unwrap().permissions().mode() & 0o777;
    let mut modes: Vec<u32> = entries.map(|entry| mode(entry.unwrap())).collect();
    modes.sort_unstable();
    modes.dedup();
    modes
}

#[test]
fn files_have_the_requested_mode() {
    let cases = [
        (0o022, None, 0o640),
        (0o077, None, 0o600),
        (0o000, None, 0o640),
        (0o077, Some(0o664), 0o664),
        (0o000, Some(0o600), 0o600),
    ];
    for (mask, mode, expected) in cases {
        let folder = Folder::new();
        let before = umask(Mode::from_raw_mode(mask));
        let options = Options {
            mode,
            ..small_extents()
        };
        let mut writer = Writer::create(&folder.0, options).unwrap();
        fill_store(&mut writer, 100, 50).unwrap();
        assert_eq!(file_modes(&folder), [expected], "during writing");
        writer.close().unwrap();
        drop(writer);
        // A repaired store and its backups keep the mode.
        let index = folder.0.join("index.situ");
        let mut bytes = std::fs::read(&index).unwrap();
        bytes[4096 + 64 + 20] ^= 1;
        std::fs::write(&index, bytes).unwrap();
        assert!(
            repair::repair_store(&folder.0, false, |_, _| ())
                .unwrap()
                .rebuilt
        );
        umask(before);
        assert!(std::fs::metadata(folder.0.join("index.situ.before-repair")).is_ok());
        assert_eq!(file_modes(&folder), [expected], "after a repair");
    }
}
