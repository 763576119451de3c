//! Images made by integer formulas, the same as in `tests/oracle/metrics.py`.

use image::{Rgb, RgbImage};

pub fn pattern(width: u32, height: u32, kind: &str) -> [RgbImage; 2] {
    let base = |x: i64, y: i64, c: i64| (x * 3 + y * 5 + c * 40 + (x * y) / 7) % 256;
    let hashed = |x: i64, y: i64, c: i64| ((x * 73_856_093) ^ (y * 19_349_663) ^ (c * 83_492_791)) % 65_521;
    let image = |f: &dyn Fn(i64, i64, i64) -> i64| {
        let value = |x, y, c| f(i64::from(x), i64::from(y), c).clamp(0, 255) as u8;
        RgbImage::from_fn(width, height, |x, y| Rgb([0, 1, 2].map(|c| value(x, y, c))))
    };
    match kind {
        "noise" => [image(&base), image(&|x, y, c| base(x, y, c) + hashed(x, y, c) % 21 - 10)],
        "shift" => [image(&base), image(&|x, y, c| base(x + 1, y, c))],
        "dark" => {
            let dark = |x: i64, y: i64, c: i64| base(x, y, c) / 16;
            [image(&dark), image(&|x, y, c| dark(x, y, c) + hashed(x, y, c) % 5 - 2)]
        }
        _ => [image(&base), image(&|x, y, c| hashed(x, y, c) % 256)],
    }
}
