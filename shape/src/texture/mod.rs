//! A texture blended from the photos: charts ([`charts`]) on a sheet ([`atlas`]), and for each
//! texel what the views that see it agree on ([`samples`]).

mod atlas;
mod charts;
mod flat;
mod options;
mod samples;
#[cfg(test)]
mod tests;

pub use options::TextureOptions;

use crate::decimate::cleaned;
use atlas::{Atlas, Texel};
use glam::{DVec2, DVec3};
use image::RgbImage;
use rayon::prelude::*;
use samples::{PreparedView, TexelSample, blend};
use scene::geometry::{Mesh, TexturedMesh};
use scene::{Cancelled, PosedPhoto, Progress};
use std::collections::HashMap;

/// Lays a mesh out flat and paints it with the photos. Texels have the width of a photo's pixel on
/// the mesh, or more where the texture would be too large. What no view sees has the mesh's own
/// colour, or that of its neighbours in the texture. Where the light glides over the surface, as a
/// glint does, the median of the views decides. `None` of a mesh without triangles, or with so many
/// charts that no texture of that size holds them.
pub fn textured(
    mesh: &Mesh,
    views: &[PosedPhoto<'_>],
    options: &TextureOptions,
    progress: &Progress,
) -> Result<Option<TexturedMesh>, Cancelled> {
    let mesh = cleaned(mesh);
    if !(mesh.size() > 0.0) {
        return Ok(None);
    }
    let atlas = Atlas::new(&mesh, texel_size(&mesh, views, options), options);
    if atlas.placed.is_empty() {
        return Ok(None);
    }
    let normals = mesh.normals();
    let texels = atlas.texels();
    let samples = sampled(&mesh, &normals, &texels, views, options, progress)?;
    let mut colors = vec![None; (atlas.size[0] * atlas.size[1]) as usize];
    for (k, texel) in texels.iter().enumerate() {
        let seen = blend(
            &samples[k * options.most_samples..(k + 1) * options.most_samples],
            options.color_tolerance,
        );
        colors[texel.at as usize] = seen.or_else(|| own_color(&mesh, texel));
    }
    spread(&mut colors, atlas.size);
    let bytes = colors.into_iter().flat_map(Option::unwrap_or_default).collect();
    let texture = RgbImage::from_raw(atlas.size[0], atlas.size[1], bytes).unwrap_or_default();
    Ok(Some(unfolded(&mesh, &normals, &atlas, texture)))
}

/// Median width of a pixel at the middle of the mesh; without views a texture of the size asked
/// for.
fn texel_size(mesh: &Mesh, views: &[PosedPhoto<'_>], options: &TextureOptions) -> f64 {
    let (low, high) = crate::decimate::bounds(&mesh.vertices);
    let middle = (low + high) / 2.0;
    let sizes = views.iter().map(|v| v.pose.centre().distance(middle) / v.camera.mean_focal());
    let mut sizes: Vec<f64> = sizes.filter(|s| *s > 0.0 && s.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let finest = mesh.area().sqrt() / f64::from(options.most_texels.max(1));
    sizes.get(sizes.len() / 2).map_or(finest, |s| s.max(finest / 2.0))
}

/// For each texel the samples with the most weight, `most_samples` each.
fn sampled(
    mesh: &Mesh,
    normals: &[DVec3],
    texels: &[Texel],
    views: &[PosedPhoto<'_>],
    options: &TextureOptions,
    progress: &Progress,
) -> Result<Vec<TexelSample>, Cancelled> {
    let most = options.most_samples.max(1);
    let mut samples = vec![TexelSample::default(); texels.len() * most];
    progress.begin("texture", views.len());
    for view in views {
        let view = PreparedView::new(*view, mesh, options);
        samples.par_chunks_mut(most).zip(texels).for_each(|(best, texel)| {
            let corners = mesh.triangles[texel.triangle as usize];
            let [a, b, c] = mesh.corners(texel.triangle as usize);
            let weights = texel.weights.map(f64::from);
            let point = a * weights[0] + b * weights[1] + c * weights[2];
            // The triangle's own side must be seen; how flatly is told by the smooth normal.
            let facing = (b - a).cross(c - a);
            let smooth: DVec3 = corners.iter().zip(weights).map(|(v, w)| normals[*v as usize] * w).sum();
            let normal = if smooth.dot(facing) > 0.0 { smooth } else { facing };
            if let Some(sample) = view.sample(point, normal.normalize_or_zero())
                && let Some(least) = best.iter_mut().min_by(|a, b| a.weight.total_cmp(&b.weight))
                && sample.weight > least.weight
            {
                *least = sample;
            }
        });
        progress.tick()?;
    }
    Ok(samples)
}

/// Of the vertices, where they have colours.
fn own_color(mesh: &Mesh, texel: &Texel) -> Option<[u8; 3]> {
    let corners = mesh.triangles[texel.triangle as usize].map(|v| mesh.colors.get(v as usize));
    let [Some(a), Some(b), Some(c)] = corners else { return None };
    let colors = [a, b, c];
    Some([0, 1, 2].map(|k| {
        let mixed = colors.iter().zip(texel.weights).map(|(color, w)| f32::from(color[k]) * w);
        mixed.sum::<f32>().round() as u8
    }))
}

/// Gives every texel without a colour the mean of those beside it that have one, ring by ring.
fn spread(colors: &mut [Option<[u8; 3]>], size: [u32; 2]) {
    let size = size.map(|n| n as usize);
    let mut ring: Vec<usize> = (0..colors.len())
        .filter(|&i| colors[i].is_none() && beside(size, i).any(|j| colors[j].is_some()))
        .collect();
    while !ring.is_empty() {
        let mixed: Vec<[u8; 3]> = ring
            .iter()
            .map(|&i| {
                let near: Vec<[u8; 3]> = beside(size, i).filter_map(|j| colors[j]).collect();
                let n = near.len().max(1) as u32;
                [0, 1, 2].map(|k| (near.iter().map(|c| u32::from(c[k])).sum::<u32>() / n) as u8)
            })
            .collect();
        ring.iter().zip(mixed).for_each(|(&i, color)| colors[i] = Some(color));
        ring = ring.into_iter().flat_map(|i| beside(size, i)).filter(|&j| colors[j].is_none()).collect();
        ring.sort_unstable();
        ring.dedup();
    }
}

/// The texels of a square of nine, as far as they are on the sheet.
fn beside([width, height]: [usize; 2], i: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % width, i / width);
    let ys = y.saturating_sub(1)..(y + 2).min(height);
    ys.flat_map(move |y| (x.saturating_sub(1)..(x + 2).min(width)).map(move |x| y * width + x))
}

/// The mesh with a vertex for each chart in which it lies.
fn unfolded(mesh: &Mesh, normals: &[DVec3], atlas: &Atlas, texture: RgbImage) -> TexturedMesh {
    let mut found = TexturedMesh { mesh: Mesh::default(), normals: vec![], uvs: vec![], texture };
    let mut known: HashMap<(u32, u32), u32> = HashMap::new();
    let size = DVec2::new(f64::from(atlas.size[0]), f64::from(atlas.size[1]));
    for placed in &atlas.placed {
        let corners = mesh.triangles[placed.triangle as usize];
        let triangle = [0, 1, 2].map(|k| {
            let next = found.mesh.vertices.len() as u32;
            let number = *known.entry((corners[k], placed.chart)).or_insert(next);
            if number == next {
                found.mesh.vertices.push(mesh.vertices[corners[k] as usize]);
                found.normals.push(normals[corners[k] as usize]);
                found.uvs.push(placed.corners[k] / size);
            }
            number
        });
        found.mesh.triangles.push(triangle);
    }
    found
}
