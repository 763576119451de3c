//! Depths in a file.

use crate::depths::{DenseDepths, pairs_at};
use crate::field::{PlaneField, from_steps, to_steps};
use crate::level::LevelImage;
use crate::neighbours::Layout;
use crate::settings::StereoSettings;
use crate::view::check;
use glam::DVec3;
use rayon::prelude::*;
use scene::PosedPhoto;
use std::io::{self, Read, Write};

impl DenseDepths {
    /// Depths and normals of all views, little endian: a view's number of pixels (4 bytes), its
    /// depths (4 bytes each), its normals (3 × 2 bytes each).
    pub fn write_to(&self, file: &mut impl Write) -> io::Result<()> {
        self.fields.iter().try_for_each(|field| field.write_to(file))
    }

    /// What [`Self::write_to`] has written of the same views, points and settings, without the
    /// costs; none where it is not theirs.
    pub fn read_from(
        file: &mut impl Read,
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
            field.read_from(file)?;
            fields.push(field);
        }
        let pairs = pairs_at(&layout, views, &images);
        let is_at_end = file.read(&mut [0]).ok()? == 0;
        is_at_end.then(|| Self::new(fields, pairs, settings))
    }
}

impl PlaneField {
    fn write_to(&self, file: &mut impl Write) -> io::Result<()> {
        let depths = self.depth.iter().flat_map(|z| z.to_le_bytes());
        let normals = self.normal.iter().zip(&self.depth);
        let known = normals.map(|(n, z)| if *z > 0.0 { to_steps(*n) } else { [0; 3] });
        let mut bytes = (self.depth.len() as u32).to_le_bytes().to_vec();
        bytes.extend(depths.chain(known.flatten().flat_map(i16::to_le_bytes)));
        file.write_all(&bytes)
    }

    /// Takes depths and normals.
    fn read_from(&mut self, file: &mut impl Read) -> Option<()> {
        let (mut count, n) = ([0; 4], self.depth.len());
        file.read_exact(&mut count).ok()?;
        if u32::from_le_bytes(count) as usize != n {
            return None;
        }
        let mut bytes = vec![0; 10 * n];
        file.read_exact(&mut bytes).ok()?;
        let (depths, normals) = bytes.split_at(4 * n);
        for (z, four) in self.depth.iter_mut().zip(depths.as_chunks::<4>().0) {
            *z = f32::from_le_bytes(*four);
        }
        let steps = normals.as_chunks::<2>().0.as_chunks::<3>().0;
        for (normal, three) in self.normal.iter_mut().zip(steps) {
            *normal = from_steps(three.map(i16::from_le_bytes));
        }
        Some(())
    }
}
