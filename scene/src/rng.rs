//! The only source of randomness: named streams, so that results do not depend on the number of
//! threads.

use rand_pcg::Pcg64Mcg;

/// The generator of a stream.
pub type Rng = Pcg64Mcg;

/// The generator for item `index` of `stream` under the user's `seed`: the same for any thread
/// count.
pub fn rng(seed: u64, stream: &str, index: u64) -> Rng {
    let mut h = 0xcbf2_9ce4_8422_2325_u64; // FNV-1a over the name, then two rounds of splitmix64
    for byte in stream.bytes() {
        h = (h ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    }
    let low = splitmix64(seed ^ splitmix64(h) ^ splitmix64(index.wrapping_add(0x9e37_79b9)));
    Pcg64Mcg::new((u128::from(splitmix64(low)) << 64) | u128::from(low))
}

fn splitmix64(x: u64) -> u64 {
    let z = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    #[test]
    fn streams_repeat_and_differ_from_each_other() {
        let draw = |seed, name, i| rng(seed, name, i).random::<u64>();
        assert_eq!(draw(1, "ransac", 7), draw(1, "ransac", 7));
        let all = [draw(1, "ransac", 7), draw(2, "ransac", 7), draw(1, "densify", 7), draw(1, "ransac", 8)];
        for i in 0..all.len() {
            assert!(!all[i + 1..].contains(&all[i]));
        }
    }
}
