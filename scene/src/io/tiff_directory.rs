//! Whether the first directory of a TIFF claims no more than its file can hold: the reader reserves
//! memory for as many values as an entry claims (Adobe, TIFF revision 6.0, 1992, section 2;
//! BigTIFF).

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// The entry whose values would not fit into the file, where there is one. Nothing is said of files
/// that are no TIFF or are cut short: their reader says what is wrong.
pub(super) fn oversized_entry(path: &Path) -> Option<u16> {
    let mut file = File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    Directory::open(&mut file)?.oversized(&mut file, length)
}

/// How numbers are stored, and where the entries begin.
struct Directory {
    little: bool,
    big: bool,
    entries: u64,
}

impl Directory {
    fn open(file: &mut File) -> Option<Self> {
        let mut header = [0; 16];
        file.read_exact(&mut header[..8]).ok()?;
        let little = &header[..2] == b"II";
        let version = number(&header[2..4], little);
        let big = version == 43;
        if !(little || &header[..2] == b"MM") || !(big || version == 42) {
            return None;
        }
        let start = if big {
            file.read_exact(&mut header[8..]).ok()?;
            number(&header[8..], little)
        } else {
            number(&header[4..8], little)
        };
        file.seek(SeekFrom::Start(start)).ok()?;
        let mut count = [0; 8];
        let count = &mut count[..if big { 8 } else { 2 }];
        file.read_exact(count).ok()?;
        Some(Self { little, big, entries: number(count, little) })
    }

    fn oversized(&self, file: &mut File, length: u64) -> Option<u16> {
        let mut entry = [0; 20];
        let entry = &mut entry[..if self.big { 20 } else { 12 }];
        for _ in 0..self.entries.min(length) {
            file.read_exact(entry).ok()?;
            let count = number(&entry[4..if self.big { 12 } else { 8 }], self.little);
            let size = size_of_type(number(&entry[2..4], self.little));
            if count.saturating_mul(size) > length {
                return Some(number(&entry[..2], self.little) as u16);
            }
        }
        None
    }
}

/// Bytes of a value, by the number of its type; at least one.
fn size_of_type(kind: u64) -> u64 {
    match kind {
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => 1,
    }
}

fn number(bytes: &[u8], little: bool) -> u64 {
    let push = |sum: u64, byte: &u8| sum << 8 | u64::from(*byte);
    if little { bytes.iter().rev().fold(0, push) } else { bytes.iter().fold(0, push) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_that_claims_more_values_than_the_file_has_bytes_is_named() {
        let path = std::env::temp_dir().join(format!("directory-{}.tif", std::process::id()));
        let written = |count: u32| {
            let entry = [&273_u16.to_be_bytes()[..], &4_u16.to_be_bytes(), &count.to_be_bytes(), &[0; 4]];
            let file = [&b"MM\0\x2a\0\0\0\x08\0\x01"[..], &entry.concat(), &[0; 40]].concat();
            std::fs::write(&path, file).unwrap();
            oversized_entry(&path)
        };
        assert_eq!((written(2), written(15), written(1 << 30)), (None, None, Some(273)));
        for odd in
            [&b""[..], b"MM", b"II\x2a\0\xff\xff\xff\xff", b"II\x2b\0\x08\0\0\0\x10\0\0\0\0\0\0\0", b"PNG"]
        {
            std::fs::write(&path, odd).unwrap();
            assert_eq!(oversized_entry(&path), None);
        }
        std::fs::remove_file(path).unwrap();
    }
}
