//! The two best partners of each descriptor.

/// For each descriptor of one image: its two largest dot products with the other image's, and the
/// best one's index.
#[derive(Clone, Debug)]
pub(super) struct TopTwo {
    /// Largest, `dot − 32768`.
    pub best: Vec<i16>,
    /// Second largest, `dot − 32768`.
    pub second: Vec<i16>,
    /// Index of the best; `u32::MAX` where none is above the floor.
    pub index: Vec<u32>,
}

impl TopTwo {
    /// `len` descriptors (rounded up so that whole vectors can be read); nothing up to `floor` is
    /// looked at.
    pub(super) fn new(len: usize, floor: u16) -> Self {
        let padded = len.next_multiple_of(64);
        let floor = add_bias(floor);
        Self { best: vec![floor; padded], second: vec![floor; padded], index: vec![u32::MAX; padded] }
    }

    /// The best partner of descriptor `i`.
    pub(super) fn partner(&self, i: usize) -> Option<u32> {
        Some(self.index[i]).filter(|&j| j != u32::MAX)
    }

    #[inline(always)]
    /// Enters the dot product of descriptor `i` with a partner.
    pub(super) fn offer(&mut self, i: usize, dot: i16, partner: u32) {
        if dot > self.best[i] {
            self.second[i] = self.best[i];
            self.best[i] = dot;
            self.index[i] = partner;
        } else if dot > self.second[i] {
            self.second[i] = dot;
        }
    }
}

/// A dot product as a signed number that compares the same.
#[inline(always)]
pub(super) fn add_bias(dot: u16) -> i16 {
    (dot ^ 0x8000) as i16
}

/// The dot product behind a biased number.
pub(super) fn remove_bias(dot: i16) -> u16 {
    (dot as u16) ^ 0x8000
}
