//! Keeps the libraries under OpenCV from writing to the terminal: what they find is told in notes
//! and errors.

use std::ffi::{c_char, c_int, c_void};

/// libavutil's `void (*)(void *, int, const char *, va_list)`; a `va_list` is passed as a pointer.
type LogCallback = extern "C" fn(*mut c_void, c_int, *const c_char, *mut c_void);

unsafe extern "C" {
    fn dlsym(handle: *mut c_void, symbol: *const c_char) -> *mut c_void;
}

extern "C" fn ignore(_: *mut c_void, _: c_int, _: *const c_char, _: *mut c_void) {}

/// Silences OpenCV and libav. (A level would not do: OpenCV sets libav's anew with every video that
/// it opens.)
pub(crate) fn silence() {
    // A level that cannot be set leaves the messages, nothing worse.
    let _ = opencv::core::set_log_level(opencv::core::LogLevel::LOG_LEVEL_SILENT);
    // SAFETY: a null handle means the symbols of the whole program (RTLD_DEFAULT); the name ends in
    // a zero byte.
    let symbol = unsafe { dlsym(std::ptr::null_mut(), c"av_log_set_callback".as_ptr()) };
    if !symbol.is_null() {
        // SAFETY: the function of that name is libavutil's, which takes one such callback and
        // returns nothing.
        let set_callback: extern "C" fn(LogCallback) = unsafe { std::mem::transmute(symbol) };
        set_callback(ignore);
    }
}
