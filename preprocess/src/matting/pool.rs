//! Planes of a picture whose memory is used again: handed back to the system after every frame and
//! faulted in anew, its pages would cost a tenth of the time of a matte.

use glam::Vec3;
use std::cell::RefCell;
use std::ops::{Deref, DerefMut};

/// Memory that no plane holds, by the type of its values; one a thread.
#[derive(Default)]
pub(crate) struct Pool {
    bytes: RefCell<Vec<Vec<u8>>>,
    words: RefCell<Vec<Vec<u32>>>,
    numbers: RefCell<Vec<Vec<f32>>>,
    colours: RefCell<Vec<Vec<Vec3>>>,
}

/// What planes are made of.
pub(crate) trait RasterValue: Copy + 'static {
    /// The free memory for values of this type.
    fn free(pool: &Pool) -> &RefCell<Vec<Vec<Self>>>;
}

macro_rules! pooled {
    ($($value:ty: $free:ident),*) => {$(
        impl RasterValue for $value {
            fn free(pool: &Pool) -> &RefCell<Vec<Vec<Self>>> {
                &pool.$free
            }
        }
    )*};
}
pooled!(u8: bytes, u32: words, f32: numbers, Vec3: colours);

impl Pool {
    /// A plane of these values, row by row.
    pub(super) fn plane<T: RasterValue>(
        &self,
        width: usize,
        values: impl Iterator<Item = T>,
    ) -> Raster<'_, T> {
        let mut memory = T::free(self).borrow_mut().pop().unwrap_or_default();
        memory.extend(values);
        Raster { values: memory, width, pool: self }
    }

    /// A plane of `count` equal values.
    pub(super) fn filled<T: RasterValue>(&self, width: usize, count: usize, value: T) -> Raster<'_, T> {
        self.plane(width, std::iter::repeat_n(value, count))
    }
}

/// A value for every pixel, row by row.
pub(crate) struct Raster<'p, T: RasterValue> {
    values: Vec<T>,
    /// Pixels in a row.
    pub width: usize,
    /// Where its memory comes from and goes to.
    pub pool: &'p Pool,
}

/// A byte for every pixel: 0 or 1.
pub(crate) type BinaryMask<'p> = Raster<'p, u8>;

impl<'p, T: RasterValue> Raster<'p, T> {
    /// Number of rows.
    pub(super) fn height(&self) -> usize {
        self.values.len() / self.width
    }

    /// Appends values, such as those of a row.
    pub(super) fn extend(&mut self, values: impl Iterator<Item = T>) {
        self.values.extend(values);
    }

    /// Another plane of the same shape.
    pub(super) fn map<U: RasterValue>(&self, value: impl FnMut(&T) -> U) -> Raster<'p, U> {
        self.pool.plane(self.width, self.values.iter().map(value))
    }

    /// The mask of the pixels whose value is so.
    pub(super) fn mask(&self, mut is_set: impl FnMut(T) -> bool) -> BinaryMask<'p> {
        self.map(|v| u8::from(is_set(*v)))
    }
}

impl<T: RasterValue> Drop for Raster<'_, T> {
    fn drop(&mut self) {
        let mut memory = std::mem::take(&mut self.values);
        memory.clear();
        T::free(self.pool).borrow_mut().push(memory);
    }
}

impl<T: RasterValue> Deref for Raster<'_, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.values
    }
}

impl<T: RasterValue> DerefMut for Raster<'_, T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_used_again_and_nothing_of_what_it_held_is_left() {
        let pool = Pool::default();
        let first = pool.plane(10, (0..1000).map(|i| (i % 7) as u8));
        let place = first.as_ptr();
        assert_eq!((first.height(), first.mask(|v| v == 6)[6]), (100, 1));
        drop(first);
        let second = pool.filled(10, 900, 0_u8);
        let third = pool.plane(3, [1_u8, 2, 3].into_iter());
        assert!([second.as_ptr(), third.as_ptr()].contains(&place));
        assert!(second.len() == 900 && second.iter().all(|v| *v == 0));
        assert_eq!(*third, [1, 2, 3]);
    }
}
