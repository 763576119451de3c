//! Depths as bytes, to be kept in a file.

use crate::depths::{DenseDepths, pairs_at};
use crate::field::{PlaneField, from_steps, to_steps};
use crate::level::LevelImage;
use crate::neighbours::Layout;
use crate::settings::StereoSettings;
use crate::view::check;
use glam::DVec3;
use rayon::prelude::*;
use scene::PosedPhoto;

impl DenseDepths {
    /// Depths and normals of all views, little endian: a view's number of pixels (4 bytes), its
    /// depths (4 bytes each), its normals (3 × 2 bytes each).
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for field in &self.fields {
            bytes.extend((field.depth.len() as u32).to_le_bytes());
            bytes.extend(field.depth.iter().flat_map(|z| z.to_le_bytes()));
            let normals = field.normal.iter().zip(&field.depth);
            let known = normals.map(|(n, z)| if *z > 0.0 { to_steps(*n) } else { [0; 3] });
            bytes.extend(known.flatten().flat_map(i16::to_le_bytes));
        }
        bytes
    }

    /// What [`Self::to_bytes`] has written of the same views, points and settings, without the
    /// costs; none where the bytes are not theirs.
    pub fn from_bytes(
        mut bytes: &[u8],
        views: &[PosedPhoto],
        points: &[DVec3],
        settings: &StereoSettings,
    ) -> Option<Self> {
        check(views).ok()?;
        let layout = Layout::new(views, points, settings);
        let level = settings.first_level(views);
        let images: Vec<LevelImage> = views.par_iter().map(|v| LevelImage::new(v, level)).collect();
        let mut fields = Vec::with_capacity(views.len());
        for image in &images {
            let mut field = PlaneField::start(image, None);
            bytes = field.read(bytes)?;
            fields.push(field);
        }
        let pairs = pairs_at(&layout, views, &images);
        bytes.is_empty().then(|| Self::new(fields, pairs, settings))
    }
}

impl PlaneField {
    /// Takes depths and normals from the front; returns the rest.
    fn read<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let (count, bytes) = bytes.split_first_chunk::<4>()?;
        let n = self.depth.len();
        if u32::from_le_bytes(*count) as usize != n {
            return None;
        }
        let (depths, bytes) = bytes.split_at_checked(4 * n)?;
        let (normals, rest) = bytes.split_at_checked(6 * n)?;
        for (z, four) in self.depth.iter_mut().zip(depths.as_chunks::<4>().0) {
            *z = f32::from_le_bytes(*four);
        }
        let steps = normals.as_chunks::<2>().0.as_chunks::<3>().0;
        for (normal, three) in self.normal.iter_mut().zip(steps) {
            *normal = from_steps(three.map(i16::from_le_bytes));
        }
        Some(rest)
    }
}
