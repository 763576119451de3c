//! Items of a HEIF file: what the boxes inside `meta` say (ISO/IEC 14496-12, 8.11; ISO/IEC
//! 23008-12, 9.3).

use super::boxes::{Checked, Cursor, MediaBox};
use std::collections::BTreeMap;

/// Where the bytes of an item lie.
#[derive(Clone, Default)]
struct Location {
    /// Inside the box `idat`, not counted from the start of the file.
    in_data_box: bool,
    /// Start and length, bytes; length 0: to the end.
    extents: Vec<(u64, u64)>,
}

/// All items of a file.
pub(super) struct Items<'a> {
    file: &'a [u8],
    data_box: &'a [u8],
    /// The item that is the picture.
    pub primary: u32,
    kinds: BTreeMap<u32, [u8; 4]>,
    locations: BTreeMap<u32, Location>,
    references: Vec<(([u8; 4], u32), Vec<u32>)>,
    properties: Vec<MediaBox<'a>>,
    associations: BTreeMap<u32, Vec<usize>>,
}

impl<'a> Items<'a> {
    /// Reads the boxes of a file.
    pub(super) fn read(file: &'a [u8]) -> Checked<Self> {
        let mut meta = find_meta(Cursor::new(file))?;
        meta.version()?;
        let properties = meta.need(b"iprp")?;
        let container = properties.need(b"ipco")?;
        Ok(Self {
            file,
            data_box: meta.find(b"idat")?.map(|d| d.rest()).unwrap_or_default(),
            primary: primary(meta.need(b"pitm")?)?,
            kinds: kinds(meta.need(b"iinf")?)?,
            locations: locations(meta.need(b"iloc")?)?,
            references: meta.find(b"iref")?.map_or(Ok(Vec::new()), references)?,
            properties: container.boxes()?,
            associations: associations(properties)?,
        })
    }

    /// The type of an item.
    pub(super) fn kind(&self, item: u32) -> Checked<[u8; 4]> {
        self.kinds.get(&item).copied().ok_or_else(|| format!("item {item} is missing"))
    }

    /// The items to which an item refers in this way.
    pub(super) fn references(&self, kind: &[u8; 4], from: u32) -> &[u32] {
        let found = self.references.iter().find(|(key, _)| *key == (*kind, from));
        found.map_or(&[], |(_, to)| to)
    }

    /// The items that refer to an item in this way.
    pub(super) fn referring(&self, kind: &[u8; 4], to: u32) -> Vec<u32> {
        let all = self.references.iter().filter(|((k, _), items)| k == kind && items.contains(&to));
        all.map(|((_, from), _)| *from).collect()
    }

    /// The properties of an item, in their order.
    pub(super) fn properties(&self, item: u32) -> Vec<MediaBox<'a>> {
        let indices = self.associations.get(&item).map_or(&[][..], Vec::as_slice);
        indices.iter().filter_map(|i| self.properties.get(i.checked_sub(1)?)).copied().collect()
    }

    /// The first property of this type.
    pub(super) fn property(&self, item: u32, kind: &[u8; 4]) -> Option<Cursor<'a>> {
        self.properties(item).into_iter().find(|p| p.kind == *kind).map(|p| p.content)
    }

    /// The bytes of an item: not more than the file has.
    pub(super) fn bytes(&self, item: u32) -> Checked<Vec<u8>> {
        let location = self.locations.get(&item).ok_or_else(|| format!("item {item} has no place"))?;
        let source = if location.in_data_box { self.data_box } else { self.file };
        let mut bytes = Vec::new();
        for &(start, length) in &location.extents {
            let from = usize::try_from(start).ok().and_then(|s| source.get(s..));
            let from = from.ok_or("the file is cut off: a picture lies beyond its end")?;
            let part = match usize::try_from(length).unwrap_or(usize::MAX) {
                0 => from,
                n => from.get(..n).ok_or("the file is cut off: a picture lies beyond its end")?,
            };
            if bytes.len() + part.len() > self.file.len() {
                return Err(format!("item {item} is longer than the file"));
            }
            bytes.extend_from_slice(part);
        }
        Ok(bytes)
    }
}

/// The box `meta`; what follows it may be cut off.
fn find_meta(mut file: Cursor<'_>) -> Checked<Cursor<'_>> {
    while let Some(next) = file.next_box()? {
        if next.kind == *b"meta" {
            return Ok(next.content);
        }
    }
    Err("holds no still picture".to_owned())
}

fn primary(mut pitm: Cursor) -> Checked<u32> {
    let (version, _) = pitm.version()?;
    pitm.id(version > 0)
}

fn kinds(mut iinf: Cursor) -> Checked<BTreeMap<u32, [u8; 4]>> {
    let (version, _) = iinf.version()?;
    iinf.id(version > 0)?;
    let mut kinds = BTreeMap::new();
    for mut entry in iinf.boxes()?.into_iter().filter(|b| b.kind == *b"infe").map(|b| b.content) {
        let (version, _) = entry.version()?;
        if version >= 2 {
            let item = entry.id(version > 2)?;
            entry.number(2)?;
            kinds.insert(item, entry.kind()?);
        }
    }
    Ok(kinds)
}

fn locations(mut iloc: Cursor) -> Checked<BTreeMap<u32, Location>> {
    let (version, _) = iloc.version()?;
    let (a, b) = (iloc.byte()?, iloc.byte()?);
    let [offset, length, base] = [a >> 4, a & 15, b >> 4].map(usize::from);
    let index = if version > 0 { usize::from(b & 15) } else { 0 };
    let count = iloc.id(version > 1)?;
    let mut locations = BTreeMap::new();
    for _ in 0..count {
        let item = iloc.id(version > 1)?;
        let method = if version > 0 { iloc.number(2)? & 15 } else { 0 };
        if method > 1 {
            return Err("items made of other items are not read".to_owned());
        }
        iloc.number(2)?;
        let start = iloc.number(base)?;
        let mut location = Location { in_data_box: method == 1, extents: Vec::new() };
        for _ in 0..iloc.number(2)? {
            iloc.number(index)?;
            let at = start.saturating_add(iloc.number(offset)?);
            location.extents.push((at, iloc.number(length)?));
        }
        locations.insert(item, location);
    }
    Ok(locations)
}

fn references(mut iref: Cursor) -> Checked<Vec<(([u8; 4], u32), Vec<u32>)>> {
    let wide = iref.version()?.0 > 0;
    let mut all = Vec::new();
    for mut reference in iref.boxes()? {
        let from = reference.content.id(wide)?;
        let count = reference.content.number(2)?;
        let to: Checked<Vec<u32>> = (0..count).map(|_| reference.content.id(wide)).collect();
        all.push(((reference.kind, from), to?));
    }
    Ok(all)
}

fn associations(properties: Cursor) -> Checked<BTreeMap<u32, Vec<usize>>> {
    let mut all: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for mut ipma in properties.boxes()?.into_iter().filter(|b| b.kind == *b"ipma").map(|b| b.content) {
        let (version, flags) = ipma.version()?;
        for _ in 0..ipma.number(4)? {
            let item = ipma.id(version > 0)?;
            for _ in 0..ipma.byte()? {
                // The highest bit says that a reader must understand the property.
                let index = if flags & 1 == 1 { ipma.number(2)? & 0x7fff } else { ipma.number(1)? & 0x7f };
                all.entry(item).or_default().push(index as usize);
            }
        }
    }
    Ok(all)
}
