//! Changes to files: bits, bytes, counts, pieces, and numbers in text.

use rand::Rng;
use rand::seq::IndexedRandom;

/// Numbers at the borders of types and of what programs expect.
const BORDERS: [u64; 14] = [
    0,
    1,
    2,
    127,
    255,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7fff_ffff_ffff_ffff,
    u64::MAX,
    0x7ff0_0000_0000_0000,
    0x7ff8_0000_0000_0000,
];

/// The same for text.
const WORDS: [&str; 12] = [
    "0",
    "-1",
    "1e999",
    "nan",
    "inf",
    "4294967296",
    "18446744073709551616",
    "1e-320",
    "../x",
    "\"",
    "{}",
    "[]",
];

/// Changes `bytes` a few times; `other` is another file of the kind.
pub fn mutate(bytes: &mut Vec<u8>, other: &[u8], rng: &mut impl Rng) {
    for _ in 0..rng.random_range(1..=4) {
        if bytes.is_empty() {
            bytes.push(rng.random());
        }
        let at = rng.random_range(0..bytes.len());
        match rng.random_range(0..9) {
            0 => bytes[at] ^= 1 << rng.random_range(0..8),
            1 => bytes[at] = rng.random(),
            2 => border(bytes, at, rng),
            3 => bytes.truncate(at),
            4 => remove(bytes, at, rng),
            5 => repeat(bytes, at, rng),
            6 => splice(bytes, at, other, rng),
            7 => word(bytes, at, rng),
            _ => bytes.insert(at, rng.random()),
        }
    }
}

fn border(bytes: &mut [u8], at: usize, rng: &mut impl Rng) {
    let width = *[1, 2, 4, 4, 8, 8].choose(rng).unwrap_or(&4);
    let value = BORDERS.choose(rng).copied().unwrap_or(0).to_le_bytes();
    // Counts and offsets stand at even places.
    let at = if rng.random() { at / 4 * 4 } else { at };
    bytes[at..].iter_mut().zip(&value[..width]).for_each(|(byte, new)| *byte = *new);
}

fn piece(bytes: &[u8], at: usize, rng: &mut impl Rng) -> std::ops::Range<usize> {
    at..(at + rng.random_range(1..=64)).min(bytes.len())
}

fn remove(bytes: &mut Vec<u8>, at: usize, rng: &mut impl Rng) {
    let range = piece(bytes, at, rng);
    bytes.drain(range);
}

fn repeat(bytes: &mut Vec<u8>, at: usize, rng: &mut impl Rng) {
    let copy = bytes[piece(bytes, at, rng)].to_vec();
    bytes.splice(at..at, copy);
}

fn splice(bytes: &mut Vec<u8>, at: usize, other: &[u8], rng: &mut impl Rng) {
    if other.is_empty() {
        return;
    }
    let from = rng.random_range(0..other.len());
    let copy = &other[piece(other, from, rng)];
    let end = (at + copy.len()).min(bytes.len());
    bytes.splice(at..end, copy.iter().copied());
}

/// Puts a word in the place of a number in text.
fn word(bytes: &mut Vec<u8>, at: usize, rng: &mut impl Rng) {
    let is_number = |b: &u8| b.is_ascii_digit() || b"+-.e".contains(b);
    let Some(start) = bytes[at..].iter().position(is_number).map(|p| at + p) else { return };
    let end = bytes[start..].iter().position(|b| !is_number(b)).map_or(bytes.len(), |p| start + p);
    let word = WORDS.choose(rng).copied().unwrap_or("0");
    bytes.splice(start..end, word.bytes());
}
