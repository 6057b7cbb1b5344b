//! Drafts: messages of several streams that are committed together.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
mod common;

use std::sync::{Arc, Mutex};

use common::{message_envelope, Folder};
use situ_store::chunk::{Input, Value};
use situ_store::extent::Fault;
use situ_store::writer::{Draft, Drafts, Size, DRAFT_MESSAGE};
use situ_store::{Compression, Encoding, Error, Options, Reader, Writer};

fn create(folder: &Folder, streams: usize) -> Writer {
    let mut writer = Writer::create(&folder.0, Options::default()).unwrap();
    for _ in 0..streams {
        writer.add_stream(Compression::None, false);
    }
    writer
}

fn add_integers(draft: &Arc<Draft>, from: u64, to: u64) -> Option<Size> {
    draft.add_messages(Encoding::Int, |addition| {
        (from..to).try_for_each(|i| addition.push(message_envelope(i), Input::Int(i as i64 * 7)))
    })
}

/// Returns the integers of a stream, and checks their envelopes.
fn read_integers(reader: &Reader, stream: u32) -> Vec<i64> {
    let mut found = Vec::new();
    while let Some(entry) = reader.entry_at(stream, found.len() as u64).unwrap() {
        for message in reader.read_chunk(&entry).unwrap().messages() {
            let (envelope, value) = message.unwrap();
            assert_eq!(envelope, message_envelope(found.len() as u64));
            match value {
                Value::Int(value) => found.push(value),
                other => panic!("{other:?}"),
            }
        }
    }
    found
}

fn integers(n: u64) -> Vec<i64> {
    (0..n as i64).map(|i| i * 7).collect()
}

#[test]
fn one_commit_writes_the_drafts_of_all_streams() {
    let folder = Folder::new();
    let mut writer = create(&folder, 500);
    let drafts = Arc::new(Drafts::default());
    let all: Vec<_> = (1..=500).map(|stream| drafts.add_draft(stream)).collect();
    for draft in &all {
        assert_eq!(draft.waiting_time(), None);
        let size = add_integers(draft, 0, 10).unwrap();
        assert_eq!((size.messages, size.bytes), (10, 80));
        assert!(draft.waiting_time().is_some());
    }
    drafts.commit_all(&mut writer).unwrap();
    assert!(all.iter().all(|draft| draft.waiting_time().is_none()));
    // Own commits and later ones work as well.
    add_integers(&all[0], 10, 3_000).unwrap();
    all[0].commit(&mut writer).unwrap();
    add_integers(&all[0], 3_000, 3_001).unwrap();
    drafts.commit_all(&mut writer).unwrap();
    writer.close().unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    assert_eq!(read_integers(&reader, 1), integers(3_001));
    assert!((2..=500).all(|stream| read_integers(&reader, stream) == integers(10)));
}

#[test]
fn an_addition_is_complete_or_not_done() {
    let folder = Folder::new();
    let mut writer = create(&folder, 1);
    let draft = Arc::new(Drafts::default()).add_draft(1);
    add_integers(&draft, 0, 5).unwrap();
    // The time does not increase, first within the addition and then against the messages before it.
    let repeated = draft.add_messages(Encoding::Int, |addition| {
        addition.push(message_envelope(5), Input::Int(0))?;
        addition.push(message_envelope(5), Input::Int(0))
    });
    assert_eq!(repeated, None);
    assert_eq!(add_integers(&draft, 4, 9), None);
    let mixed = draft.add_messages(Encoding::Int, |addition| {
        addition.push(message_envelope(5), Input::Int(0))?;
        addition.push(message_envelope(6), Input::Float(0.5))
    });
    assert_eq!(mixed, None);
    let other = draft.add_messages(Encoding::Float, |addition| {
        addition.push(message_envelope(5), Input::Float(0.5))
    });
    assert_eq!(other, None);
    assert_eq!(add_integers(&draft, 5, 8).unwrap().messages, 8);
    draft.commit(&mut writer).unwrap();
    assert_eq!(
        read_integers(&Reader::open(&folder.0).unwrap(), 1),
        integers(8)
    );
}

#[test]
fn large_messages_do_not_fit() {
    let draft = Arc::new(Drafts::default()).add_draft(1);
    let bytes = vec![1; DRAFT_MESSAGE + 1];
    let add = |i: u64, bytes: &[u8]| {
        draft.add_messages(Encoding::Bytes, |addition| {
            addition.push(message_envelope(i), Input::Bytes(bytes))
        })
    };
    assert!(add(0, &bytes[1..]).is_some());
    assert_eq!(add(1, &bytes), None);
    assert_eq!(
        add(1, b"ab").map(|size| size.bytes),
        Some(DRAFT_MESSAGE + 2 + 16)
    );
}

#[test]
fn a_refused_draft_waits_and_does_not_affect_others() {
    let folder = Folder::new();
    let mut writer = create(&folder, 2);
    let drafts = Arc::new(Drafts::default());
    let (refused, other) = (drafts.add_draft(1), drafts.add_draft(2));
    let late = message_envelope(3);
    writer
        .push(1, late, Encoding::Int, 0, Input::Int(0))
        .unwrap();
    writer.commit().unwrap();
    add_integers(&refused, 0, 2).unwrap();
    add_integers(&other, 0, 2).unwrap();
    drafts.commit_all(&mut writer).unwrap();
    assert_eq!(other.waiting_time(), None);
    assert!(refused.waiting_time().is_some());
    assert_eq!(
        refused.commit(&mut writer),
        Err(Error::NotIncreasing(1, 3_000, 0))
    );
    let unknown = drafts.add_draft(9);
    add_integers(&unknown, 0, 1).unwrap();
    assert_eq!(unknown.commit(&mut writer), Err(Error::UnknownStream(9)));
}

#[test]
fn after_a_failed_commit_all_messages_wait_in_order() {
    for steps in 0.. {
        let folder = Folder::new();
        let fault = Fault::after(12 + steps, false);
        let mut writer = Writer::create(
            &folder.0,
            Options {
                fault,
                ..Options::default()
            },
        )
        .unwrap();
        writer.add_stream(Compression::None, false);
        writer.add_stream(Compression::None, false);
        let drafts = Arc::new(Drafts::default());
        let both = [drafts.add_draft(1), drafts.add_draft(2)];
        for draft in &both {
            add_integers(draft, 0, 2_000).unwrap();
        }
        if drafts.commit_all(&mut writer).is_ok() {
            assert!(steps > 5);
            return;
        }
        for draft in &both {
            assert!(draft.waiting_time().is_some());
            assert_eq!(add_integers(draft, 2_000, 2_001).unwrap().messages, 2_001);
        }
        // Another writer shows that the messages are the same as before.
        let folder = Folder::new();
        let mut writer = create(&folder, 2);
        drafts.commit_all(&mut writer).unwrap();
        let reader = Reader::open(&folder.0).unwrap();
        for stream in [1, 2] {
            assert_eq!(read_integers(&reader, stream), integers(2_001));
        }
    }
}

#[test]
fn messages_added_during_commits_are_all_stored() {
    let folder = Folder::new();
    let writer = Mutex::new(create(&folder, 4));
    let drafts = Arc::new(Drafts::default());
    std::thread::scope(|scope| {
        for stream in 1..=4 {
            let (draft, writer) = (drafts.add_draft(stream), &writer);
            scope.spawn(move || {
                for i in 0..2_000 {
                    let size = add_integers(&draft, i * 5, i * 5 + 5).unwrap();
                    if size.messages >= 700 {
                        draft.commit(&mut writer.lock().unwrap()).unwrap();
                    }
                }
            });
        }
        for _ in 0..200 {
            drafts.commit_all(&mut writer.lock().unwrap()).unwrap();
            std::thread::yield_now();
        }
    });
    let mut writer = writer.into_inner().unwrap();
    drafts.commit_all(&mut writer).unwrap();
    writer.close().unwrap();
    let reader = Reader::open(&folder.0).unwrap();
    assert!((1..=4).all(|stream| read_integers(&reader, stream) == integers(10_000)));
}
