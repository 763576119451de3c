//! Masks and labels whose memory is used again: handed back to the system after every frame and faulted in anew, its pages would cost a
//! tenth of the key's time.

use std::cell::RefCell;
use std::ops::{Deref, DerefMut};
use std::thread::LocalKey;

/// A value a pixel; when dropped, its memory waits for the next one of this thread.
pub(crate) struct Reused<T: Pooled>(Vec<T>);

/// A byte a pixel: 0 or 1.
pub(crate) type Mask = Reused<u8>;

/// At most so many wait, of each kind, and none larger than this: what waits is memory that other stages lack. Bytes.
const MOST: usize = 12;
const LARGEST: usize = 4 << 20;

/// What can be kept.
pub(crate) trait Pooled: Sized + 'static {
    /// What waits in this thread.
    fn pool() -> &'static LocalKey<RefCell<Vec<Vec<Self>>>>;
}

impl Pooled for u8 {
    fn pool() -> &'static LocalKey<RefCell<Vec<Vec<Self>>>> {
        thread_local!(static POOL: RefCell<Vec<Vec<u8>>> = const { RefCell::new(Vec::new()) });
        &POOL
    }
}

impl Pooled for u32 {
    fn pool() -> &'static LocalKey<RefCell<Vec<Vec<Self>>>> {
        thread_local!(static POOL: RefCell<Vec<Vec<u32>>> = const { RefCell::new(Vec::new()) });
        &POOL
    }
}

impl<T: Pooled> Default for Reused<T> {
    /// Empty, with the memory of an earlier one.
    fn default() -> Self {
        let waiting = T::pool().try_with(|pool| pool.borrow_mut().pop()).ok().flatten();
        Self(waiting.unwrap_or_default())
    }
}

impl<T: Pooled> Drop for Reused<T> {
    fn drop(&mut self) {
        let mut memory = std::mem::take(&mut self.0);
        memory.clear();
        // Where the thread ends there is no pool any more.
        let _ = T::pool().try_with(|pool| {
            let mut pool = pool.borrow_mut();
            if pool.len() < MOST && (1..=LARGEST).contains(&(memory.capacity() * size_of::<T>())) {
                pool.push(memory);
            }
        });
    }
}

impl<T: Pooled> FromIterator<T> for Reused<T> {
    fn from_iter<I: IntoIterator<Item = T>>(values: I) -> Self {
        let mut reused = Self::default();
        reused.0.extend(values);
        reused
    }
}

impl<T: Pooled + Clone> Reused<T> {
    /// So many times the same.
    pub fn filled(value: T, count: usize) -> Self {
        let mut reused = Self::default();
        reused.0.resize(count, value);
        reused
    }

    /// A copy.
    pub fn of(values: &[T]) -> Self {
        let mut reused = Self::default();
        reused.0.extend_from_slice(values);
        reused
    }
}

impl<'a, T: Pooled> IntoIterator for &'a Reused<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.iter()
    }
}

impl<T: Pooled> Deref for Reused<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<T: Pooled> DerefMut for Reused<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_used_again_and_nothing_of_what_it_held_is_left() {
        let first: Mask = (0..1000).map(|i| (i % 7) as u8).collect();
        let place = first.as_ptr();
        drop(first);
        let second = Mask::filled(0, 900);
        assert_eq!(second.as_ptr(), place);
        assert!(second.len() == 900 && second.iter().all(|v| *v == 0));
        let third = Mask::of(&[1, 2, 3]);
        assert_ne!(third.as_ptr(), place, "the second holds it");
        assert_eq!(&*third, [1, 2, 3]);
        drop(Mask::filled(0, LARGEST + 1));
        assert_eq!(Mask::default().0.capacity(), 0, "too large to be kept");
    }
}
