//! What a texture is made from.

/// How a texture is made.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureOptions {
    /// Most texels along a side of the texture.
    pub most_texels: u32,
    /// Of a texel the best views, at most so many, are blended.
    pub most_samples: usize,
    /// A view is trusted fully so far inside the matte's border, pixels; on the border not at all.
    pub border_px: usize,
    /// A surface is hidden if another lies before it by more than this, share of the mesh's size
    /// (what a pixel's width takes in on a slanted surface is added).
    pub slack: f64,
    /// Colours that differ from the median by so much count half, of 255.
    pub color_tolerance: f64,
}

impl Default for TextureOptions {
    /// Source: docs/decisions/16.
    fn default() -> Self {
        Self { most_texels: 4096, most_samples: 8, border_px: 6, slack: 0.003, color_tolerance: 12.0 }
    }
}
