//! The limit of memory that helper programs inherit.

/// What else may have made a helper program fail: a limit of memory, which it inherits. Empty where
/// none is set.
#[cfg(target_os = "linux")]
pub(crate) fn memory_note() -> String {
    use rustix::process::{Resource, getrlimit};
    let limits = [Resource::Data, Resource::As].map(|which| getrlimit(which).current);
    limits.into_iter().flatten().min().map_or_else(String::new, |bytes| {
        let mib = bytes >> 20;
        format!("the limit of {mib} MiB of memory may be too low: raise --memory-limit or `ulimit -d`; or ")
    })
}

/// No limit of memory is looked for on this system.
#[cfg(not(target_os = "linux"))]
pub(crate) fn memory_note() -> String {
    String::new()
}
