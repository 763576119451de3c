//! Memory from the system, and advice where there is none left.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;

/// What a user can do. No memory is needed to say it.
const ADVICE: &str = "error: out of memory; lower --max-size, --frames, --threads or --max-gaussians, \
    or raise --memory-limit where it was given\n";

/// The system's allocator; where it has nothing left the program ends with exit code 1, not with a
/// signal.
pub(crate) struct Advising;

/// Ends the program where an allocation has failed.
fn given(pointer: *mut u8) -> *mut u8 {
    if pointer.is_null() {
        let _ = std::io::stderr().write_all(ADVICE.as_bytes()); // unbuffered; nobody listens if it fails
        // SAFETY: ends the process without running anything that could need memory.
        unsafe { nix::libc::_exit(1) }
    }
    pointer
}

// SAFETY: hands everything on to the system's allocator.
unsafe impl GlobalAlloc for Advising {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        given(unsafe { System.alloc(layout) })
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        given(unsafe { System.alloc_zeroed(layout) })
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as above.
        given(unsafe { System.realloc(pointer, layout, size) })
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}
