//! File names: sorted as people read them, and safe in every file format that will hold them.

use std::cmp::Ordering;
use std::collections::HashSet;

/// Compares with runs of digits taken as numbers: `img2` before `img10`.
pub(crate) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut x, mut y) = (a.as_bytes(), b.as_bytes());
    while let (Some(&p), Some(&q)) = (x.first(), y.first()) {
        if p.is_ascii_digit() && q.is_ascii_digit() {
            let (m, n) = (digits(x), digits(y));
            let (u, v) = (trimmed(&x[..m]), trimmed(&y[..n]));
            let order = u.len().cmp(&v.len()).then_with(|| u.cmp(v));
            if order != Ordering::Equal {
                return order;
            }
            (x, y) = (&x[m..], &y[n..]);
        } else {
            let order = p.to_ascii_lowercase().cmp(&q.to_ascii_lowercase());
            if order != Ordering::Equal {
                return order;
            }
            (x, y) = (&x[1..], &y[1..]);
        }
    }
    x.len().cmp(&y.len()).then_with(|| a.cmp(b))
}

fn digits(s: &[u8]) -> usize {
    s.iter().take_while(|c| c.is_ascii_digit()).count()
}

fn trimmed(s: &[u8]) -> &[u8] {
    let zeros = s.iter().take_while(|c| **c == b'0').count();
    &s[zeros.min(s.len() - 1)..]
}

/// The name with everything replaced that splits lines of COLMAP's text files or means something to
/// a shell or a file system; unlike all in `used`, into which it goes.
pub(crate) fn safe_name(stem: &str, extension: &str, used: &mut HashSet<String>) -> String {
    let mut stem: String = stem
        .chars()
        .map(|c| if c.is_alphanumeric() || "._-+()@=".contains(c) { c } else { '_' })
        .take(120)
        .collect();
    if stem.is_empty() || stem.starts_with(['.', '-']) {
        stem.insert(0, '_');
    }
    let mut name = format!("{stem}.{extension}");
    let mut n = 1;
    // Some file systems do not tell capitals from small letters.
    while !used.insert(name.to_lowercase()) {
        n += 1;
        name = format!("{stem}_{n}.{extension}");
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names =
            ["img10.png", "img2.png", "IMG1.png", "img002.png", "a", "img99999999999999999999999.png"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(
            names,
            ["a", "IMG1.png", "img002.png", "img2.png", "img10.png", "img99999999999999999999999.png"]
        );
    }

    #[test]
    fn names_become_safe_and_stay_apart() {
        let mut used = HashSet::new();
        assert_eq!(safe_name("my photo\n1", "png", &mut used), "my_photo_1.png");
        assert_eq!(safe_name("my_photo 1", "png", &mut used), "my_photo_1_2.png");
        assert_eq!(safe_name("..", "jpg", &mut used), "_...jpg");
        assert_eq!(safe_name("-rf", "jpg", &mut used), "_-rf.jpg");
        assert_eq!(safe_name("A", "jpg", &mut used), "A.jpg");
        assert_eq!(safe_name("a", "jpg", &mut used), "a_2.jpg");
    }
}
