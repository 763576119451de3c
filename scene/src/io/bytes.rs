//! Little-endian values one after another from a file that may lie about its contents.

use super::error::IoError;
use std::path::Path;

/// A cursor over the bytes of a file; every read is checked.
pub(crate) struct ByteReader<'a> {
    pub path: &'a Path,
    data: &'a [u8],
    at: usize,
}

macro_rules! read_le {
    ($name:ident, $t:ty) => {
        pub(crate) fn $name(&mut self, what: &str) -> Result<$t, IoError> {
            Ok(<$t>::from_le_bytes(self.array(what)?))
        }
    };
}

impl<'a> ByteReader<'a> {
    pub(crate) fn new(path: &'a Path, data: &'a [u8]) -> Self {
        Self { path, data, at: 0 }
    }

    /// Bytes not yet read.
    pub(crate) fn left(&self) -> usize {
        self.data.len() - self.at
    }

    /// The next `n` bytes.
    pub(crate) fn take(&mut self, n: usize, what: &str) -> Result<&'a [u8], IoError> {
        if n > self.left() {
            return Err(self.truncated(what, n as u64));
        }
        let slice = &self.data[self.at..self.at + n];
        self.at += n;
        Ok(slice)
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], IoError> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N, what)?);
        Ok(out)
    }

    read_le!(u8, u8);
    read_le!(u32, u32);
    read_le!(i32, i32);
    read_le!(u64, u64);
    read_le!(f64, f64);

    /// N doubles.
    pub(crate) fn f64s<const N: usize>(&mut self, what: &str) -> Result<[f64; N], IoError> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = self.f64(what)?;
        }
        Ok(out)
    }

    /// A 64-bit count of records of at least `record` bytes: believed only if the file has room for
    /// them.
    pub(crate) fn count(&mut self, record: usize, what: &str) -> Result<usize, IoError> {
        let n = self.u64(what)?;
        self.check_room(n, record, what)
    }

    /// `n` as a `usize` if that many records of at least `record` bytes are left.
    pub(crate) fn check_room(&self, n: u64, record: usize, what: &str) -> Result<usize, IoError> {
        let needed = n.saturating_mul(record as u64);
        if needed > self.left() as u64 {
            return Err(self.truncated(&format!("{n} × {what}"), needed));
        }
        Ok(n as usize)
    }

    /// Text that ends with a NUL byte.
    pub(crate) fn c_string(&mut self, what: &str) -> Result<&'a str, IoError> {
        let rest = &self.data[self.at..];
        let Some(end) = rest.iter().take(4096).position(|&b| b == 0) else {
            return Err(IoError::format(
                self.path,
                format!("{what} has no end within 4096 bytes; the file is damaged"),
            ));
        };
        self.at += end + 1;
        std::str::from_utf8(&rest[..end])
            .map_err(|_| IoError::format(self.path, format!("{what} is not UTF-8")))
    }

    fn truncated(&self, what: &str, needed: u64) -> IoError {
        IoError::Truncated {
            path: self.path.to_path_buf(),
            what: what.to_string(),
            needed,
            left: self.left() as u64,
        }
    }
}
