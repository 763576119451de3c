//! Names of files that come out of files.

/// A name that is not a plain path below a folder.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the file name {name:?} {why}; only relative names inside the folder are accepted")]
pub struct UnsafeName {
    /// The name, shortened.
    pub name: String,
    /// What is wrong with it.
    pub why: &'static str,
}

/// The name itself if joining it to a folder stays inside that folder on every system: relative, no
/// `..`, no backslash, no drive letter, no control characters, at most 1,024 bytes.
pub fn safe_name(name: &str) -> Result<&str, UnsafeName> {
    let bytes = name.as_bytes();
    let drive = bytes.len() > 1 && bytes[1] == b':' && bytes[0].is_ascii_alphabetic();
    let why = if name.is_empty() {
        "is empty"
    } else if name.len() > 1024 {
        "is longer than 1024 bytes"
    } else if name.starts_with('/') || drive {
        "is an absolute path"
    } else if name.contains('\\') {
        "contains a backslash"
    } else if name.chars().any(char::is_control) {
        "contains a control character"
    } else if name.split('/').any(|part| part == "..") {
        "contains '..'"
    } else if name.split('/').all(|part| part.is_empty() || part == ".") || name.ends_with('/') {
        "names no file"
    } else {
        return Ok(name);
    };
    Err(UnsafeName { name: name.chars().take(80).collect(), why })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_lead_out_of_the_folder_are_refused() {
        for bad in ["", "/etc/passwd", "..", "a/../../b", "a\\b", "C:/x.png", "a\0b", "a\nb", ".", "a/", "./"]
        {
            assert!(safe_name(bad).is_err(), "{bad:?}");
        }
        for good in ["a.png", "sub/a.png", "a..b.png", "ä ö.jpg", "..a/b", "./a.png"] {
            assert_eq!(safe_name(good), Ok(good));
        }
    }
}
