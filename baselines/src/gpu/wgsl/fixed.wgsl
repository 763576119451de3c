// Sums in fixed point of 64 bits, of which 44 lie behind the point: their order does not matter, so
// that results are the same in every run. Two words, as WGSL has no atomics of f32 or of 64 bits.

// Words of a number; larger ones than 2¹⁹ are cut.
fn to_fixed(value: f32) -> vec2u {
    // In units of 2⁻¹²: the high word, exactly.
    let size = min(abs(value), 524287.0) * 4096.0;
    let whole = floor(size);
    var words = vec2u(u32((size - whole) * 4294967296.0), u32(whole));
    if (value < 0.0) {
        words = negated(words);
    }
    return words;
}

fn negated(words: vec2u) -> vec2u {
    let low = ~words.x + 1u;
    return vec2u(low, ~words.y + select(0u, 1u, low == 0u));
}

fn from_fixed(low: u32, high: u32) -> f32 {
    var words = vec2u(low, high);
    let negative = (high & 0x80000000u) != 0u;
    if (negative) {
        words = negated(words);
    }
    let size = f32(words.y) / 4096.0 + f32(words.x) / 17592186044416.0;
    return select(size, -size, negative);
}
