//! The user's browser.

use std::process::{Command, Stdio};

/// Opens an address in the user's browser: `$BROWSER`, or what the desktop opens pages with. Says
/// whether there is one.
pub(super) fn open(address: &str) -> bool {
    let set = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let opener = match set("BROWSER") {
        // A list as for man-db and Python: the first is asked.
        Some(named) => named.split(':').next().unwrap_or_default().to_owned(),
        None if cfg!(target_os = "macos") => "open".to_owned(),
        None if set("DISPLAY").or_else(|| set("WAYLAND_DISPLAY")).is_some() => "xdg-open".to_owned(),
        None => return false,
    };
    let mut command = Command::new(opener);
    command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.spawn().is_ok()
}
