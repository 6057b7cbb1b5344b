//! `situ_speak VOICE RATE PITCH ssml|text TEXT`: text to speech with the library of espeak-ng, loaded at run time.
//!
//! Unlike the espeak-ng program, the library reports when each word and phoneme is spoken. It keeps its state in
//! globals and is licensed under the GPL, so it runs in this separate process, which ends after the text or when its
//! output is closed. As a NIF, it would allow one synthesis at a time, and its crashes would end the VM. Recognizing
//! word times in the audio would give no phonemes. A process costs about 20 ms per text. The package is outside the
//! workspace `native/`, because it is not a library of the VM, and a change here rebuilds none of them.
//!
//! Standard output is a sequence of frames. Each is a tag, the payload size (u32, little endian), and the payload:
//!
//! | tag | payload |
//! |---|---|
//! | `r` | u32: the sample rate |
//! | `a` | audio: 16-bit samples, one channel |
//! | `w` | a word: u32 samples before it, u32 its position in the text (characters from 0), u32 its length |
//! | `s` | a sentence: the same fields as a word |
//! | `m` | a mark: u32 samples before it, then its name |
//! | `p` | a phoneme: u32 samples before it, then its symbol in the International Phonetic Alphabet; or empty |
//!
//! Exit status: 0, 2 (arguments), 3 (no library), 4 (unknown voice), 5 (the text cannot be spoken), 6 (output closed).
#![allow(unsafe_code)]

use std::ffi::{c_char, c_int, c_uint, c_void, CStr, CString};
use std::io::{self, Write};
use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};

const LIBRARY: &CStr = c"libespeak-ng.so.1";
const NOW: c_int = 2;
const SYNCHRONOUS: c_int = 2;
const PHONEME_EVENTS: c_int = 0x1;
const PHONEMES_IN_IPA: c_int = 0x2;
const DONT_EXIT: c_int = 0x8000;
const RATE: c_int = 1;
const PITCH: c_int = 3;
const CHARACTERS: c_int = 1;
const TEXT_IN_UTF8: c_uint = 0x1;
const SSML: c_uint = 0x10;
const PAUSE_AT_END: c_uint = 0x1000;

const LIST_END: c_int = 0;
const WORD: c_int = 1;
const SENTENCE: c_int = 2;
const MARK: c_int = 3;
const PHONEME: c_int = 7;

/// The struct `espeak_EVENT` of speak_lib.h.
#[repr(C)]
struct Event {
    kind: c_int,
    message: c_uint,
    position: c_int,
    length: c_int,
    milliseconds: c_int,
    sample: c_int,
    user_data: *mut c_void,
    id: [c_char; 8],
}

type Callback = extern "C" fn(*const i16, c_int, *const Event) -> c_int;
type Initialize = unsafe extern "C" fn(c_int, c_int, *const c_char, c_int) -> c_int;
type SetCallback = unsafe extern "C" fn(Callback);
type SetVoice = unsafe extern "C" fn(*const c_char) -> c_int;
type SetParameter = unsafe extern "C" fn(c_int, c_int, c_int) -> c_int;
type Synthesize = unsafe extern "C" fn(
    *const c_void,
    usize,
    c_uint,
    c_int,
    c_uint,
    c_uint,
    *mut c_uint,
    *mut c_void,
) -> c_int;

extern "C" {
    fn dlopen(name: *const c_char, flags: c_int) -> *mut c_void;
    fn dlsym(library: *mut c_void, name: *const c_char) -> *mut c_void;
}

static OUTPUT_CLOSED: AtomicBool = AtomicBool::new(false);

fn write_frame(tag: u8, parts: &[&[u8]]) -> io::Result<()> {
    let size: usize = parts.iter().map(|part| part.len()).sum();
    let mut out = io::stdout().lock();
    out.write_all(&[tag])?;
    out.write_all(&(size as u32).to_le_bytes())?;
    parts.iter().try_for_each(|part| out.write_all(part))
}

fn to_bytes(n: c_int) -> [u8; 4] {
    (n.max(0) as u32).to_le_bytes()
}

fn write_event(event: &Event) -> io::Result<()> {
    let at = to_bytes(event.sample);
    match event.kind {
        WORD => write_frame(
            b'w',
            &[&at, &to_bytes(event.position - 1), &to_bytes(event.length)],
        ),
        SENTENCE => write_frame(
            b's',
            &[&at, &to_bytes(event.position - 1), &to_bytes(event.length)],
        ),
        PHONEME => {
            let name: Vec<u8> = event
                .id
                .iter()
                .map(|c| *c as u8)
                .take_while(|c| *c != 0)
                .collect();
            write_frame(b'p', &[&at, &name])
        }
        MARK => {
            let name = usize::from_ne_bytes(event.id.map(|c| c as u8)) as *const c_char;
            if name.is_null() {
                return Ok(());
            }
            // SAFETY: for a mark, the library passes the address of its name, a C string that lives during the call.
            write_frame(b'm', &[&at, unsafe { CStr::from_ptr(name) }.to_bytes()])
        }
        _ => Ok(()),
    }
}

extern "C" fn on_synthesis(samples: *const i16, count: c_int, events: *const Event) -> c_int {
    let mut written = Ok(());
    let mut next = events;
    // SAFETY: the library passes a list of events that ends with LIST_END, and `count` samples; both are valid during
    // this call only.
    unsafe {
        while written.is_ok() && !next.is_null() && (*next).kind != LIST_END {
            written = write_event(&*next);
            next = next.add(1);
        }
        if written.is_ok() && !samples.is_null() && count > 0 {
            let bytes = std::slice::from_raw_parts(samples.cast::<u8>(), count as usize * 2);
            written = write_frame(b'a', &[bytes]);
        }
    }
    if written.is_err() {
        OUTPUT_CLOSED.store(true, Ordering::Relaxed);
    }
    c_int::from(written.is_err())
}

/// Looks up a function of the library.
///
/// # Safety
/// `F` must be the type of the function with this name.
unsafe fn load_function<F: Copy>(library: *mut c_void, name: &CStr) -> F {
    let address = dlsym(library, name.as_ptr());
    if address.is_null() {
        exit(3);
    }
    std::mem::transmute_copy(&address)
}

fn main() {
    let arguments: Vec<String> = std::env::args_os()
        .skip(1)
        .filter_map(|a| a.into_string().ok())
        .collect();
    let [voice, rate, pitch, kind, text] = arguments.as_slice() else {
        exit(2)
    };
    let (Ok(rate), Ok(pitch)) = (rate.parse::<c_int>(), pitch.parse::<c_int>()) else {
        exit(2)
    };
    let (Ok(voice), Ok(text)) = (CString::new(voice.as_str()), CString::new(text.as_str())) else {
        exit(2)
    };
    let ssml = if kind == "ssml" { SSML } else { 0 };

    // SAFETY: the names and types are those in speak_lib.h of espeak-ng, and the strings are null-terminated and
    // outlive the calls.
    unsafe {
        let library = dlopen(LIBRARY.as_ptr(), NOW);
        if library.is_null() {
            exit(3);
        }
        let initialize: Initialize = load_function(library, c"espeak_Initialize");
        let set_callback: SetCallback = load_function(library, c"espeak_SetSynthCallback");
        let set_voice: SetVoice = load_function(library, c"espeak_SetVoiceByName");
        let set_parameter: SetParameter = load_function(library, c"espeak_SetParameter");
        let synthesize: Synthesize = load_function(library, c"espeak_Synth");

        let rate_hz = initialize(
            SYNCHRONOUS,
            0,
            std::ptr::null(),
            PHONEME_EVENTS | PHONEMES_IN_IPA | DONT_EXIT,
        );
        if rate_hz <= 0 {
            exit(3);
        }
        if set_voice(voice.as_ptr()) != 0 {
            exit(4);
        }
        set_parameter(RATE, rate, 0);
        set_parameter(PITCH, pitch, 0);
        set_callback(on_synthesis);
        if write_frame(b'r', &[&to_bytes(rate_hz)]).is_err() {
            exit(6);
        }
        let bytes = text.as_bytes_with_nul();
        let flags = TEXT_IN_UTF8 | PAUSE_AT_END | ssml;
        let status = synthesize(
            bytes.as_ptr().cast(),
            bytes.len(),
            0,
            CHARACTERS,
            0,
            flags,
            std::ptr::null_mut(),
            std::ptr::null_mut(),
        );
        if OUTPUT_CLOSED.load(Ordering::Relaxed) || io::stdout().flush().is_err() {
            exit(6);
        }
        exit(if status == 0 { 0 } else { 5 });
    }
}
