//! A slice of which several tasks write parts at the same time.

use std::marker::PhantomData;
use std::ops::Range;

/// A slice that is lent to several tasks; each takes parts that no other task takes.
pub(super) struct SharedSlice<'a, T> {
    start: *mut T,
    len: usize,
    lent: PhantomData<&'a mut [T]>,
}

// SAFETY: it stands for a `&mut [T]` whose parts are handed to other threads.
unsafe impl<T: Send> Send for SharedSlice<'_, T> {}
// SAFETY: the only access is `part`, whose callers vouch that parts do not overlap.
unsafe impl<T: Send> Sync for SharedSlice<'_, T> {}

impl<'a, T> SharedSlice<'a, T> {
    /// Lends the slice.
    pub(super) fn new(slice: &'a mut [T]) -> Self {
        Self { start: slice.as_mut_ptr(), len: slice.len(), lent: PhantomData }
    }

    /// The values of a range, which must lie within the slice.
    ///
    /// # Safety
    /// No part that overlaps this one is in use as long as this one is.
    #[allow(clippy::mut_from_ref)] // that is what it is for
    pub(super) unsafe fn part(&self, range: Range<usize>) -> &mut [T] {
        assert!(range.start <= range.end && range.end <= self.len, "{range:?} of {}", self.len);
        // SAFETY: the range lies within the slice, which is lent for 'a, and the caller vouches
        // that nobody else uses it.
        unsafe { std::slice::from_raw_parts_mut(self.start.add(range.start), range.len()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "3..5 of 4")]
    fn no_part_leaves_the_slice() {
        let mut values = [0u8; 4];
        let shared = SharedSlice::new(&mut values);
        // SAFETY: it is the only part.
        let _ = unsafe { shared.part(3..5) };
    }
}
