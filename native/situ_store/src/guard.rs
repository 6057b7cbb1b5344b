//! Memory maps that survive the truncation of their file.
//!
//! Reading a page of a map after another program has truncated the file raises SIGBUS, which ends the process. The
//! handler in this module replaces the page with zeros and records this in the map's slot: the reader sees a wrong
//! checksum, calls `is_torn`, and returns an error. The handler only affects maps that are registered here; any
//! other SIGBUS is passed on to the previous handler. See docs/adr/0130-memory-maps-survive-truncated-files.md.

use std::ops::{Deref, DerefMut};
use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering};
use std::sync::{Mutex, Once};

const PAGE: usize = 4096;
const SLOTS: usize = 256;

/// The address range of a map. A slot with start 0 is free.
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
    fn next_block(&self) -> Option<&'static Block> {
        // SAFETY: blocks are created by `Box::leak` and never freed or moved.
        unsafe { self.next.load(Ordering::Acquire).as_ref() }
    }
}

static FIRST_BLOCK: Block = Block::new();
/// Held while a slot is taken. The signal handler only reads slots.
static SLOT_LOCK: Mutex<()> = Mutex::new(());
static INSTALL: Once = Once::new();
/// The previous handler, as returned by `sigaction`.
static PREVIOUS_HANDLER: AtomicUsize = AtomicUsize::new(0);
static PREVIOUS_TAKES_INFO: AtomicBool = AtomicBool::new(false);

fn all_slots() -> impl Iterator<Item = &'static Slot> {
    std::iter::successors(Some(&FIRST_BLOCK), |block| block.next_block())
        .flat_map(|block| &block.slots)
}

fn take_slot(start: usize, end: usize) -> &'static Slot {
    INSTALL.call_once(install_handler);
    let _taking = SLOT_LOCK.lock().unwrap_or_else(|p| p.into_inner());
    let free = all_slots().find(|slot| slot.start.load(Ordering::Relaxed) == 0);
    let slot = free.unwrap_or_else(|| {
        let block: &'static Block = Box::leak(Box::new(Block::new()));
        let last = std::iter::successors(Some(&FIRST_BLOCK), |block| block.next_block()).last();
        let last = last.unwrap_or(&FIRST_BLOCK);
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
fn install_handler() {
    // SAFETY: the structures are zeroed, which is a valid value, and filled as sigaction(2) requires. The handler
    // uses only operations that are allowed in a signal handler: atomics and mmap(2). It runs on the alternate
    // stack, as the BEAM requires of handlers.
    unsafe {
        let mut new: libc::sigaction = std::mem::zeroed();
        let mut old: libc::sigaction = std::mem::zeroed();
        new.sa_sigaction = on_sigbus as *const () as usize;
        new.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
        libc::sigemptyset(&mut new.sa_mask);
        if libc::sigaction(libc::SIGBUS, &new, &mut old) == 0 {
            PREVIOUS_HANDLER.store(old.sa_sigaction, Ordering::Release);
            let takes_info = old.sa_flags & libc::SA_SIGINFO != 0;
            PREVIOUS_TAKES_INFO.store(takes_info, Ordering::Release);
        }
    }
}

#[allow(unsafe_code)]
extern "C" fn on_sigbus(
    signal: libc::c_int,
    info: *mut libc::siginfo_t,
    context: *mut libc::c_void,
) {
    // SAFETY: the kernel passes a valid `info`. The replaced page is within a map registered by its owner, which
    // unregisters it before unmapping it. errno is restored.
    unsafe {
        let at = (*info).si_addr() as usize;
        let ours = all_slots().find(|slot| {
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

/// SAFETY: must be called from the handler, with the handler's arguments.
#[allow(unsafe_code)]
unsafe fn pass_on(signal: libc::c_int, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
    let before = PREVIOUS_HANDLER.load(Ordering::Acquire);
    if before == libc::SIG_DFL || before == libc::SIG_IGN {
        // The access is retried and ends the process, as it would without this handler.
        let mut default: libc::sigaction = std::mem::zeroed();
        default.sa_sigaction = libc::SIG_DFL;
        libc::sigaction(signal, &default, std::ptr::null_mut());
    } else if PREVIOUS_TAKES_INFO.load(Ordering::Acquire) {
        let handler: extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void) =
            std::mem::transmute(before);
        handler(signal, info, context);
    } else {
        let handler: extern "C" fn(libc::c_int) = std::mem::transmute(before);
        handler(signal);
    }
}

/// A map that stays registered until it is dropped.
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
        let slot = take_slot(start, (start + map.len()).next_multiple_of(PAGE));
        Guarded { slot, map }
    }

    /// Returns whether a part of the file was missing. The bytes of that part read as zeros, and writes to it are
    /// lost.
    pub fn is_torn(&self) -> bool {
        self.slot.torn.load(Ordering::Acquire)
    }

    /// Returns the map itself.
    pub fn inner(&self) -> &M {
        &self.map
    }
}

impl<M> Drop for Guarded<M> {
    // This runs before the map's own drop, which unmaps it.
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
