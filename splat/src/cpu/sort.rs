//! sort and bin: Gaussians by depth, then by tile.
//! in: `keys` \[N\] depth bits, `records` \[N\]. out: [`Bins`]: for each 16 × 16 tile the Gaussians
//! that can reach it, front to back.
//!
//! One radix sort a view by depth (ties by index), then a stable counting sort by tile. What is
//! touched at random is kept small: keys travel with their numbers, tiles are listed in the order
//! of the Gaussians, and a pair's tile gives way to its position in the same place.

use super::project::{CULLED, LOG2_255, Record};
use super::tile::TILE;

/// The Gaussian–tile pairs of a view. Invariant: `offsets` ascend from 0 to the number of pairs.
#[derive(Debug, Default)]
pub(super) struct Bins {
    tiles_x: usize,
    tiles_y: usize,
    depth: DepthOrder,
    /// [tiles + 1] where the tile's pairs begin in `list`.
    offsets: Vec<u32>,
    /// \[pairs\] Gaussian numbers by tile, front to back.
    list: Vec<u32>,
    /// \[pairs\] by Gaussian: first its tile, then the position of the pair in `list`.
    positions: Vec<u32>,
    /// \[N + 1\] where the Gaussian's pairs begin in `positions`.
    begins: Vec<u32>,
    cursor: Vec<u32>,
}

/// The visible Gaussians of a view by depth.
#[derive(Debug, Default)]
struct DepthOrder {
    /// Front to back.
    order: Vec<u32>,
    /// Depth bits above the Gaussian's number, and room to sort them in.
    keyed: [Vec<u64>; 2],
    /// Keys by digit.
    counts: Vec<[u32; 2048]>,
}

impl DepthOrder {
    /// `order`: the Gaussians that are not culled by ascending key, ties by index (LSD radix sort,
    /// 11 bits a pass).
    fn sort(&mut self, keys: &[u32]) {
        let [from, to] = &mut self.keyed;
        from.clear();
        let seen = (0..).zip(keys).filter(|&(_, &key)| key != CULLED);
        from.extend(seen.map(|(i, &key): (u64, _)| u64::from(key) << 32 | i));
        to.resize(from.len(), 0);
        self.counts.clear();
        self.counts.resize(SHIFTS.len(), [0; 2048]);
        for &k in from.iter() {
            for (count, shift) in self.counts.iter_mut().zip(SHIFTS) {
                count[digit(k, shift)] += 1;
            }
        }
        for (count, shift) in self.counts.iter_mut().zip(SHIFTS) {
            // Depths of one scene share their leading bits.
            if count.contains(&(from.len() as u32)) {
                continue;
            }
            let mut sum = 0;
            for slot in count.iter_mut() {
                sum += std::mem::replace(slot, sum);
            }
            for &k in from.iter() {
                let slot = &mut count[digit(k, shift)];
                to[*slot as usize] = k;
                *slot += 1;
            }
            std::mem::swap(from, to);
        }
        self.order.clear();
        self.order.extend(from.iter().map(|&k| k as u32));
    }
}

impl Bins {
    /// Gaussians that touch a tile.
    pub(super) fn visible(&self) -> usize {
        self.depth.order.len()
    }

    /// Gaussian–tile pairs.
    pub(super) fn pairs(&self) -> usize {
        self.list.len()
    }

    /// Numbers of the pairs of a tile. Those of different tiles do not overlap.
    #[inline(always)]
    pub(super) fn pairs_of(&self, tile: usize) -> std::ops::Range<usize> {
        self.offsets[tile] as usize..self.offsets[tile + 1] as usize
    }

    /// The Gaussians of a tile, front to back.
    #[inline(always)]
    pub(super) fn gaussians_of(&self, tile: usize) -> &[u32] {
        &self.list[self.pairs_of(tile)]
    }

    /// Numbers of the pairs of a Gaussian.
    #[inline(always)]
    pub(super) fn positions_of(&self, gaussian: usize) -> &[u32] {
        &self.positions[self.begins[gaussian] as usize..self.begins[gaussian + 1] as usize]
    }

    /// Fills everything for an image of `width × height` pixels.
    pub(super) fn fill(&mut self, keys: &[u32], records: &[Record], width: usize, height: usize) {
        self.tiles_x = width.div_ceil(TILE);
        self.tiles_y = height.div_ceil(TILE);
        let mut depth = std::mem::take(&mut self.depth);
        rayon::join(|| depth.sort(keys), || self.pair(keys, records));
        self.depth = depth;
        self.scatter();
    }
    /// The tiles that each Gaussian touches, and the number of pairs of each tile.
    fn pair(&mut self, keys: &[u32], records: &[Record]) {
        let tiles = self.tiles_x * self.tiles_y;
        self.offsets.clear();
        self.offsets.resize(tiles + 1, 0);
        self.begins.clear();
        self.begins.push(0);
        self.positions.clear();
        for (record, &key) in records.iter().zip(keys) {
            if key != CULLED {
                self.touch(record);
            }
            self.begins.push(self.positions.len() as u32);
        }
        for t in 0..tiles {
            self.offsets[t + 1] += self.offsets[t];
        }
    }

    /// Lists the tiles of one Gaussian, and counts them.
    fn touch(&mut self, record: &Record) {
        let [y0, y1] = tile_span(record.y, record.extent_y, self.tiles_y);
        let [x0, x1] = tile_span(record.x, record.extent_x, self.tiles_x);
        let exact = y1 > y0 + 1 && x1 > x0 + 1;
        for ty in y0..y1 {
            let [x0, x1] = if exact { row_span(record, ty, self.tiles_x) } else { [x0, x1] };
            for tx in x0..x1 {
                let tile = ty * self.tiles_x + tx;
                self.positions.push(tile as u32);
                self.offsets[tile + 1] += 1;
            }
        }
    }

    /// `list`, front to back.
    fn scatter(&mut self) {
        self.list.resize(self.positions.len(), 0);
        self.cursor.clear();
        self.cursor.extend_from_slice(&self.offsets);
        for &i in &self.depth.order {
            let pairs = self.begins[i as usize] as usize..self.begins[i as usize + 1] as usize;
            for position in &mut self.positions[pairs] {
                let slot = &mut self.cursor[*position as usize];
                self.list[*slot as usize] = i;
                *position = *slot;
                *slot += 1;
            }
        }
    }
}

/// Lowest bits of the digits of a key. Source: derived from 11 bits a digit.
const SHIFTS: [u32; 3] = [32, 43, 54];

/// The digit of a key: 11 bits from bit `shift` on.
fn digit(key: u64, shift: u32) -> usize {
    (key >> shift) as usize & 2047
}

/// Half-open range of tiles that `centre ± extent` overlaps.
fn tile_span(centre: f32, extent: f32, tiles: usize) -> [usize; 2] {
    let (low, high) = (tile_of(centre - extent), tile_of(centre + extent));
    [low.min(tiles), (high + 1).min(tiles)]
}

/// Tile of a pixel coordinate; negative ones count as 0.
fn tile_of(pixel: f32) -> usize {
    // Truncation is the floor of what is not negative, without a call to floor; the cast saturates.
    (pixel * (1.0 / TILE as f32)) as u32 as usize
}

/// Half-open range of tiles in row `ty` that the ellipse `alpha ≥ 1/255` overlaps: the row's band
/// cuts the convex ellipse in a convex set, whose projection on x is an interval.
fn row_span(g: &Record, ty: usize, tiles: usize) -> [usize; 2] {
    let (a, b, c) = (2.0 * g.half_xx, g.xy, 2.0 * g.half_yy);
    let reach = 2.0 * (g.log2_opacity + LOG2_255);
    let top = (ty * TILE) as f32 - g.y;
    let low = top.max(-g.extent_y);
    let high = (top + TILE as f32).min(g.extent_y);
    let tilt = b / c * g.extent_x;
    let [(dy_left, half_left), (dy_right, half_right)] = [tilt, -tilt].map(|dy| {
        let dy = dy.min(high).max(low);
        (dy, (reach * a - (a * c - b * b) * dy * dy).max(0.0).sqrt())
    });
    let left = (-b * dy_left - half_left) / a;
    let right = (-b * dy_right + half_right) / a;
    if !(left.is_finite() && right.is_finite()) {
        return tile_span(g.x, g.extent_x, tiles);
    }
    // Rounding of the ellipse's rim must not lose a pixel.
    let slack = 0.01 + 1e-4 * g.extent_x;
    let (first, last) = (tile_of(g.x + left - slack), tile_of(g.x + right + slack));
    let [x0, x1] = tile_span(g.x, g.extent_x, tiles);
    [first.clamp(x0, x1), (last + 1).clamp(x0, x1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(x: f32, y: f32, conic: [f32; 3], opacity: f32) -> Record {
        let reach = 2.0 * (opacity * 255.0).ln();
        let det = conic[0] * conic[2] - conic[1] * conic[1];
        let log2e = std::f32::consts::LOG2_E;
        Record {
            x,
            y,
            half_xx: 0.5 * log2e * conic[0],
            xy: log2e * conic[1],
            half_yy: 0.5 * log2e * conic[2],
            log2_opacity: opacity.log2(),
            extent_x: (reach * conic[2] / det).sqrt(),
            extent_y: (reach * conic[0] / det).sqrt(),
            ..Record::default()
        }
        .with_chords()
    }

    #[test]
    fn every_pixel_a_gaussian_can_colour_lies_in_one_of_its_tiles() {
        // Miri is a thousand times slower.
        let some = if cfg!(miri) { 100 } else { 1 };
        for case in (0..200).step_by(some) {
            let f = |k: f32| ((case as f32 + 1.0) * k).sin();
            let (angle, long, short) = (f(1.7) * 3.2, 2.0 + 30.0 * f(0.3).abs(), 0.6 + 2.0 * f(0.9).abs());
            let (s, c) = angle.sin_cos();
            let (p, q) = (long.powi(-2), short.powi(-2));
            let conic = [c * c * p + s * s * q, s * c * (p - q), s * s * p + c * c * q];
            let g = record(80.0 + 90.0 * f(2.1), 60.0 + 70.0 * f(3.3), conic, 0.01 + 0.98 * f(0.77).abs());
            let mut bins = Bins::default();
            bins.fill(&[1], &[g], 160, 120);
            let touched: Vec<usize> = (0..80).filter(|&t| !bins.pairs_of(t).is_empty()).collect();
            for (y, x) in (0..120).flat_map(|y| (0..160).map(move |x| (y, x))) {
                let (dx, dy) = (g.x - x as f32 - 0.5, g.y - y as f32 - 0.5);
                let power = g.half_xx * dx * dx + g.xy * dx * dy + g.half_yy * dy * dy;
                if (g.log2_opacity - power).exp2() >= 1.0001 / 255.0 {
                    assert!(touched.contains(&(y / 16 * 10 + x / 16)), "case {case} pixel {x} {y}");
                }
            }
        }
    }

    #[test]
    fn tiles_list_gaussians_front_to_back_and_equal_depths_by_index() {
        let records = vec![record(8.0, 8.0, [0.1, 0.0, 0.1], 0.5); 5];
        let keys = [3.0f32.to_bits(), 1.0f32.to_bits(), CULLED, 1.0f32.to_bits(), 2.0f32.to_bits()];
        let mut bins = Bins::default();
        bins.fill(&keys, &records, 16, 16);
        assert_eq!(bins.list, [1, 3, 4, 0]);
        assert!(bins.positions_of(2).is_empty());
        for i in [0usize, 1, 3, 4] {
            assert_eq!(bins.positions_of(i).len(), 1);
            assert_eq!(bins.list[bins.positions_of(i)[0] as usize], i as u32);
        }
    }
}
