//! Still pictures of HEIF files, which phones write as `.heic` and browsers read as `.avif`
//! (ISO/IEC 23008-12; AV1 Image File Format 1.1): where the coded tiles lie, how they go together
//! and which way is up. Their pixels are left to a decoder of HEVC or AV1.

mod boxes;
mod items;

use self::boxes::{Checked, Cursor};
use self::items::Items;
use super::attitude::turned;
use super::error::IoError;
use super::exif::ExifCamera;
use super::limits::{IMAGE_BYTES, IMAGE_SIDE};
use super::load::{ImageInfo, turns_sideways};
use image::metadata::Orientation;
use std::io::Read;
use std::path::Path;

/// How the tiles of a picture are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeifCodec {
    /// H.265, as in `.heic`.
    Hevc,
    /// AV1, as in `.avif`.
    Av1,
}

/// A picture in tiles of one size.
#[derive(Clone, Debug, PartialEq)]
pub struct HeifTiles {
    /// How they are coded.
    pub codec: HeifCodec,
    /// Width and height of the picture as stored, pixels.
    pub size: (u32, u32),
    /// Width and height of a tile, pixels; those on the right and below may reach over the picture.
    pub tile_size: (u32, u32),
    /// Number of tiles beside each other.
    pub columns: u32,
    /// The tiles, row by row, each decodable alone: NAL units with start codes (ITU-T H.265, annex
    /// B), or OBUs of one temporal unit.
    pub tiles: Vec<Vec<u8>>,
    /// The matrix of the colours (ITU-T H.273, 8.3), where the file says it.
    pub matrix: Option<u16>,
    /// Whether samples have the full range, where the file says it.
    pub full_range: Option<bool>,
}

/// The picture of a HEIF file.
#[derive(Clone, Debug, PartialEq)]
pub struct HeifPicture {
    /// Its colours.
    pub colour: HeifTiles,
    /// Its alpha, as grey values, where it has some.
    pub alpha: Option<HeifTiles>,
    /// What makes the stored picture upright; the orientation in EXIF says the same once more.
    pub orientation: Orientation,
    /// What EXIF says.
    pub exif: ExifCamera,
}

impl HeifPicture {
    /// Whether the file begins like a HEIF file.
    pub fn is_in(path: &Path) -> bool {
        let mut head = [0; 12];
        let read = std::fs::File::open(path).and_then(|mut f| f.read_exact(&mut head));
        let brand = &head[8..12];
        let known: [&[u8]; 9] =
            [b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1", b"avif", b"avis"];
        read.is_ok() && head[4..8] == *b"ftyp" && known.contains(&brand)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// If it is damaged, too large, or coded in another way than HEVC or AV1.
    pub fn read(path: &Path) -> Result<Self, IoError> {
        let length = std::fs::metadata(path).map_err(IoError::file("read", path))?.len();
        if length > IMAGE_BYTES {
            return Err(IoError::format(path, format!("{length} bytes are too many for a photo")));
        }
        let bytes = std::fs::read(path).map_err(IoError::file("read", path))?;
        Self::parse(&bytes).map_err(|message| IoError::Image { path: path.into(), message })
    }

    /// Parses the content of a file.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let items = Items::read(bytes)?;
        let alpha = items.referring(b"auxl", items.primary).into_iter().find(|i| is_alpha(&items, *i));
        Ok(Self {
            colour: HeifTiles::of(&items, items.primary, bytes.len())?,
            alpha: alpha.map(|item| HeifTiles::of(&items, item, bytes.len())).transpose()?,
            orientation: orientation(&items)?,
            exif: ExifCamera::in_container(bytes),
        })
    }

    /// What the header says of the upright picture.
    pub fn info(&self) -> ImageInfo {
        let (mut width, mut height) = self.colour.size;
        if turns_sideways(self.orientation) {
            (width, height) = (height, width);
        }
        let (has_alpha, exif) = (self.alpha.is_some(), self.exif.clone());
        let focal_prior_px = exif.focal_px(width, height);
        let up = exif.up.and_then(|up| turned(up, self.orientation));
        ImageInfo { width, height, has_alpha, exif, focal_prior_px, up, is_panorama: false }
    }
}

fn is_alpha(items: &Items, item: u32) -> bool {
    let urns: [&[u8]; 2] = [b"urn:mpeg:mpegB:cicp:systems:auxiliary:alpha", b"urn:mpeg:hevc:2015:auxid:1"];
    let content = items.property(item, b"auxC").map(|c| c.rest()).unwrap_or_default();
    urns.iter().any(|urn| content.get(4..).is_some_and(|name| name.starts_with(urn)))
}

impl HeifTiles {
    /// `most`: bytes that all tiles together may have.
    fn of(items: &Items, item: u32, most: usize) -> Checked<Self> {
        let grid = (items.kind(item)? == *b"grid").then(|| Grid::read(items, item)).transpose()?;
        let parts = match &grid {
            Some(grid) => grid.parts(items.references(b"dimg", item))?,
            None => &[item][..],
        };
        let tile_size = extent(items, parts[0])?;
        let size = grid.as_ref().map_or(tile_size, |g| g.size);
        check_size(size, tile_size, parts.len())?;
        if items.property(item, b"clap").is_some() {
            return Err("is cut to a part of what is stored (`clap`); save it anew".to_owned());
        }
        let codec = codec_of(items, parts[0])?;
        let (mut tiles, mut total) = (Vec::with_capacity(parts.len()), 0);
        for &part in parts {
            if codec_of(items, part)? != codec || extent(items, part)? != tile_size {
                return Err("has tiles of several kinds".to_owned());
            }
            let tile = tile(items, part, codec)?;
            total += tile.len();
            // Start codes and parameter sets make a tile longer than in the file.
            if total > most.saturating_mul(4).max(tile.len()) {
                return Err("has tiles longer than the file".to_owned());
            }
            tiles.push(tile);
        }
        let said = colour(items, item)?.or(colour(items, parts[0])?);
        Ok(Self {
            codec,
            size,
            tile_size,
            columns: grid.map_or(1, |g| g.columns),
            tiles,
            matrix: said.map(|c| c.matrix).filter(|&m| m != UNSPECIFIED),
            full_range: said.map(|c| c.full_range),
        })
    }
}

/// A picture put together from tiles (ISO/IEC 23008-12, 6.6.2.3).
struct Grid {
    columns: u32,
    rows: u32,
    size: (u32, u32),
}

impl Grid {
    fn read(items: &Items, item: u32) -> Checked<Self> {
        let bytes = items.bytes(item)?;
        let mut content = Cursor::new(&bytes);
        content.byte()?;
        let wide = content.byte()? & 1 == 1;
        let [rows, columns] = [content.byte()?, content.byte()?].map(|n| u32::from(n) + 1);
        Ok(Self { columns, rows, size: (content.id(wide)?, content.id(wide)?) })
    }

    fn parts<'a>(&self, items: &'a [u32]) -> Checked<&'a [u32]> {
        let count = (self.columns * self.rows) as usize;
        items.get(..count).ok_or_else(|| format!("has {} of its {count} tiles", items.len()))
    }
}

fn check_size(size: (u32, u32), tile: (u32, u32), tiles: usize) -> Checked<()> {
    let sides = [size.0, size.1, tile.0, tile.1];
    let [whole, tile] = [size, tile].map(|(w, h)| u64::from(w) * u64::from(h));
    let decoded = tile.saturating_mul(tiles as u64).max(whole).saturating_mul(3);
    if sides.iter().any(|s| *s == 0 || *s > IMAGE_SIDE) || decoded > IMAGE_BYTES {
        return Err(format!("{} × {} pixels in {tiles} tiles are not accepted", size.0, size.1));
    }
    Ok(())
}

fn extent(items: &Items, item: u32) -> Checked<(u32, u32)> {
    let mut ispe = items.property(item, b"ispe").ok_or("a picture has no size")?;
    ispe.version()?;
    Ok((ispe.id(true)?, ispe.id(true)?))
}

fn codec_of(items: &Items, item: u32) -> Checked<HeifCodec> {
    match &items.kind(item)? {
        b"hvc1" => Ok(HeifCodec::Hevc),
        b"av01" => Ok(HeifCodec::Av1),
        other => Err(format!(
            "a picture of type `{}` in HEIF; convert it to an 8-bit PNG or JPEG",
            other.escape_ascii()
        )),
    }
}

/// The coded picture with what a decoder needs before it.
fn tile(items: &Items, item: u32, codec: HeifCodec) -> Checked<Vec<u8>> {
    let coded = items.bytes(item)?;
    match codec {
        // A temporal delimiter without content; the item begins with its sequence header.
        HeifCodec::Av1 => Ok([&[0x12, 0x00], &coded[..]].concat()),
        HeifCodec::Hevc => {
            let configuration = items.property(item, b"hvcC").ok_or("a picture has no `hvcC`")?;
            annex_b(configuration, Cursor::new(&coded))
        }
    }
}

/// NAL units with start codes from those of the configuration (ISO/IEC 14496-15, 8.3.3.1) and those
/// of the picture, which have their length before them.
fn annex_b(mut configuration: Cursor, mut coded: Cursor) -> Checked<Vec<u8>> {
    let mut stream = Vec::with_capacity(coded.rest().len() + configuration.rest().len());
    configuration.take(21)?;
    let length_size = usize::from(configuration.byte()? & 3) + 1;
    for _ in 0..configuration.byte()? {
        configuration.byte()?;
        for _ in 0..configuration.number(2)? {
            let length = configuration.number(2)? as usize;
            stream.extend_from_slice(&[&[0, 0, 0, 1], configuration.take(length)?].concat());
        }
    }
    while !coded.rest().is_empty() {
        let length = coded.number(length_size)? as usize;
        stream.extend_from_slice(&[&[0, 0, 0, 1], coded.take(length)?].concat());
    }
    Ok(stream)
}

/// Matrix 2: unknown. Source: ITU-T H.273, table 4.
const UNSPECIFIED: u16 = 2;

/// What the box `colr` says of the samples.
#[derive(Clone, Copy)]
struct Colour {
    matrix: u16,
    full_range: bool,
}

fn colour(items: &Items, item: u32) -> Checked<Option<Colour>> {
    for mut property in items.properties(item) {
        if property.kind == *b"colr" && property.content.kind()? == *b"nclx" {
            property.content.take(4)?;
            let matrix = property.content.number(2)? as u16;
            return Ok(Some(Colour { matrix, full_range: property.content.byte()? & 0x80 != 0 }));
        }
    }
    Ok(None)
}

/// Quarter turns to the left (`irot`) and mirrors (`imir`) in their order, as one.
fn orientation(items: &Items) -> Checked<Orientation> {
    // First, perhaps, mirrored left to right; then quarter turns clockwise.
    let (mut mirrored, mut quarters) = (false, 0);
    for mut property in items.properties(items.primary) {
        match &property.kind {
            b"irot" => quarters += 4 - i32::from(property.content.byte()? & 3),
            b"imir" => {
                let top_to_bottom = property.content.byte()? & 1 == 1;
                mirrored = !mirrored;
                quarters = if top_to_bottom { 2 - quarters } else { -quarters };
            }
            _ => {}
        }
    }
    Ok(match (mirrored, quarters.rem_euclid(4)) {
        (false, 0) => Orientation::NoTransforms,
        (false, 1) => Orientation::Rotate90,
        (false, 2) => Orientation::Rotate180,
        (false, _) => Orientation::Rotate270,
        (true, 0) => Orientation::FlipHorizontal,
        (true, 1) => Orientation::Rotate270FlipH,
        (true, 2) => Orientation::FlipVertical,
        (true, _) => Orientation::Rotate90FlipH,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURNED: &[u8] = include_bytes!("../../../tests/fixtures/heif/turned.heic");
    const GRID: &[u8] = include_bytes!("../../../tests/fixtures/heif/grid.heic");
    const ALPHA: &[u8] = include_bytes!("../../../tests/fixtures/heif/alpha.avif");

    #[test]
    fn a_turned_photo_says_its_orientation_its_lens_and_its_place() {
        let picture = HeifPicture::parse(TURNED).unwrap();
        assert_eq!((picture.colour.size, picture.info().width), ((96, 64), 64));
        assert_eq!((picture.colour.codec, picture.orientation), (HeifCodec::Hevc, Orientation::Rotate90));
        assert_eq!((picture.exif.make.as_deref(), picture.exif.focal_35mm), (Some("Maker"), Some(26.0)));
        let gps = picture.exif.gps.unwrap();
        let place = (gps.latitude_deg, gps.longitude_deg, gps.altitude_m);
        assert_eq!(place, (52.5, 13.25, Some(34.5)));
    }

    #[test]
    fn tiles_and_alpha_are_found() {
        let grid = HeifPicture::parse(GRID).unwrap().colour;
        let layout = (grid.size, grid.tile_size, grid.columns, grid.tiles.len());
        assert_eq!(layout, ((150, 100), (64, 64), 3, 6));
        assert_eq!((grid.matrix, grid.full_range), (Some(6), Some(true)));
        assert!(grid.tiles.iter().all(|t| t.starts_with(&[0, 0, 0, 1])), "start codes");
        let picture = HeifPicture::parse(ALPHA).unwrap();
        assert_eq!(picture.colour.codec, HeifCodec::Av1);
        assert_eq!(picture.alpha.unwrap().size, (80, 60));
    }

    #[test]
    fn damage_is_an_error_or_a_picture_and_never_a_panic() {
        for whole in [TURNED, GRID, ALPHA] {
            // EXIF may lie behind the picture.
            let most = whole.len() * 3 / 4;
            assert!((0..most).all(|n| HeifPicture::parse(&whole[..n]).is_err()), "a part of a file");
            let end = whole.windows(4).position(|w| w == b"mdat").unwrap().min(900);
            for (at, bit) in (0..end).flat_map(|at| (0..8).map(move |bit| (at, bit))) {
                let mut bad = whole.to_vec();
                bad[at] ^= 1 << bit;
                if let Ok(picture) = HeifPicture::parse(&bad) {
                    let bytes: usize = picture.colour.tiles.iter().map(Vec::len).sum();
                    assert!(bytes <= 5 * whole.len(), "{bytes} bytes of tiles");
                }
            }
        }
    }
}
