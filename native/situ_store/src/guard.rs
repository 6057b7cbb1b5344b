//! Memory maps that outlive their file's end.
//! Reading a page of a map whose file another program has cut raises SIGBUS, which ends the process. Here a handler
//! puts a page of zeros in its place and notes it: the reader sees a wrong checksum, calls `torn`, and returns an
//! error. The handler only looks at maps that are registered here; any other SIGBUS goes where it went before.

use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering};
use std::sync::{Mutex, Once};

const PAGE: usize = 4096;
const SLOTS: usize = 256;

/// Where a map lies. A slot with start 0 is free.
struct Slot {
    start: AtomicUsize,
    end: AtomicUsize,
    torn: AtomicBool,
}

struct Block {
    slots: [Slot; SLOTS],
    next: AtomicPtr<Block>,
}

impl Block {
    const fn new() -> Self {
        Block {
            slots: [const {
                Slot {
                    start: AtomicUsize::new(0),
                    end: AtomicUsize::new(0),
                    torn: AtomicBool::new(false),
                }
            }; SLOTS],
            next: AtomicPtr::new(std::ptr::null_mut()),
        }
    }

    #[allow(unsafe_code)]
    fn following(&self) -> Option<&'static Block> {
        // SAFETY: blocks are made by `Box::leak` and never freed or moved.
        unsafe { self.next.load(Ordering::Acquire).as_ref() }
    }
}

static FIRST: Block = Block::new();
/// Held while slots are taken; the signal handler only reads them.
static TAKING: Mutex<()> = Mutex::new(());
static INSTALL: Once = Once::new();
/// The handler that was there before ours, as `sigaction` told it.
static BEFORE: AtomicUsize = AtomicUsize::new(0);
static BEFORE_TAKES_INFO: AtomicBool = AtomicBool::new(false);

fn slots() -> impl Iterator<Item = &'static Slot> {
    std::iter::successors(Some(&FIRST), |block| block.following()).flat_map(|block| &block.slots)
}

fn take(start: usize, end: usize) -> &'static Slot {
    INSTALL.call_once(install);
    let _taking = TAKING.lock().unwrap_or_else(|p| p.into_inner());
    let free = slots().find(|slot| slot.start.load(Ordering::Relaxed) == 0);
    let slot = free.unwrap_or_else(|| {
        let block: &'static Block = Box::leak(Box::new(Block::new()));
        let last = std::iter::successors(Some(&FIRST), |block| block.following()).last();
        let last = last.unwrap_or(&FIRST);
        last.next
            .store(std::ptr::from_ref(block).cast_mut(), Ordering::Release);
        &block.slots[0]
    });
    slot.torn.store(false, Ordering::Relaxed);
    slot.end.store(end, Ordering::Relaxed);
    slot.start.store(start, Ordering::Release);
    slot
}

#[allow(unsafe_code)]
fn install() {
    // SAFETY: the structures are zeroed, which is a valid value of them, and filled as sigaction(2) says. The handler
    // does only what a signal handler may: atomics and mmap(2). It runs on the alternate stack, as the BEAM demands
    // of handlers.
    unsafe {
        let mut new: libc::sigaction = std::mem::zeroed();
        let mut old: libc::sigaction = std::mem::zeroed();
        new.sa_sigaction = on_sigbus as *const () as usize;
        new.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
        libc::sigemptyset(&mut new.sa_mask);
        if libc::sigaction(libc::SIGBUS, &new, &mut old) == 0 {
            BEFORE.store(old.sa_sigaction, Ordering::Release);
            let takes_info = old.sa_flags & libc::SA_SIGINFO != 0;
            BEFORE_TAKES_INFO.store(takes_info, Ordering::Release);
        }
    }
}

#[allow(unsafe_code)]
extern "C" fn on_sigbus(
    signal: libc::c_int,
    info: *mut libc::siginfo_t,
    context: *mut libc::c_void,
) {
    // SAFETY: the kernel gives a valid `info`; the page replaced lies within a map registered by its owner, which
    // unregisters it before it unmaps; errno is put back as it was.
    unsafe {
        let at = (*info).si_addr() as usize;
        let ours = slots().find(|slot| {
            let start = slot.start.load(Ordering::Acquire);
            start != 0 && start <= at && at < slot.end.load(Ordering::Relaxed)
        });
        let errno = *libc::__errno_location();
        if let Some(slot) = ours {
            slot.torn.store(true, Ordering::Release);
            let page = libc::mmap(
                (at / PAGE * PAGE) as *mut libc::c_void,
                PAGE,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_FIXED | libc::MAP_PRIVATE | libc::MAP_ANONYMOUS,
                -1,
                0,
            );
            *libc::__errno_location() = errno;
            if page != libc::MAP_FAILED {
                return;
            }
        }
        pass_on(signal, info, context);
    }
}

/// SAFETY: called from the handler, with what it was given.
#[allow(unsafe_code)]
unsafe fn pass_on(signal: libc::c_int, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
    let before = BEFORE.load(Ordering::Acquire);
    if before == libc::SIG_DFL || before == libc::SIG_IGN {
        // The access is tried again, and ends the process as if we were not there.
        let mut default: libc::sigaction = std::mem::zeroed();
        default.sa_sigaction = libc::SIG_DFL;
        libc::sigaction(signal, &default, std::ptr::null_mut());
    } else if BEFORE_TAKES_INFO.load(Ordering::Acquire) {
        let handler: extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void) =
            std::mem::transmute(before);
        handler(signal, info, context);
    } else {
        let handler: extern "C" fn(libc::c_int) = std::mem::transmute(before);
        handler(signal);
    }
}

/// A map that is registered as long as it lives.
pub struct Guarded<M> {
    slot: &'static Slot,
    map: M,
}

/// A guarded map for reading.
pub type Map = Guarded<memmap2::Mmap>;
/// A guarded map for writing.
pub type MapMut = Guarded<memmap2::MmapMut>;

impl<M: Deref<Target = [u8]>> Guarded<M> {
    /// Registers a map.
    pub fn new(map: M) -> Self {
        let start = map.as_ptr() as usize;
        let slot = take(start, (start + map.len()).next_multiple_of(PAGE));
        Guarded { slot, map }
    }

    /// Whether a part of it was found missing: its bytes are zeros now, and writes to it are lost.
    pub fn torn(&self) -> bool {
        self.slot.torn.load(Ordering::Acquire)
    }

    /// The map itself.
    pub fn inner(&self) -> &M {
        &self.map
    }
}

impl<M> Drop for Guarded<M> {
    // Runs before the map's own drop, which unmaps it.
    fn drop(&mut self) {
        self.slot.start.store(0, Ordering::Release);
    }
}

impl<M: Deref<Target = [u8]>> Deref for Guarded<M> {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        &self.map
    }
}

impl<M: DerefMut<Target = [u8]>> DerefMut for Guarded<M> {
    fn deref_mut(&mut self) -> &mut [u8] {
        &mut self.map
    }
}

impl<M> std::fmt::Debug for Guarded<M> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Guarded")
    }
}
