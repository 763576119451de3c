//! The PLY header.

use crate::io::error::IoError;
use std::path::Path;

/// How the rows are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Number types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Size in a binary file.
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value at the start of `bytes`, which must be long enough.
    pub(crate) fn decode(self, bytes: &[u8], little: bool) -> f64 {
        let mut b = [0_u8; 8];
        let n = self.bytes();
        b[..n].copy_from_slice(&bytes[..n]);
        if !little {
            b[..n].reverse();
        }
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

/// A property is a number or a list (type of its count, type of its items).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PlyKind {
    Scalar(Scalar),
    List(Scalar, Scalar),
}

impl PlyKind {
    /// The least bytes it takes in a binary file.
    pub(crate) fn min_bytes(self) -> usize {
        match self {
            Self::Scalar(t) | Self::List(t, _) => t.bytes(),
        }
    }
}

/// A named column.
#[derive(Clone, Debug)]
pub(crate) struct Property {
    pub name: String,
    pub kind: PlyKind,
}

/// A named table.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Whether it has a scalar property of that name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.properties.iter().any(|p| p.name == name && matches!(p.kind, PlyKind::Scalar(_)))
    }

    /// Offset and type of every column, and the size of a row; `None` where lists make rows differ.
    pub(crate) fn fixed_offsets(&self) -> Option<(Vec<(usize, Scalar)>, usize)> {
        let mut at = 0;
        let mut columns = Vec::with_capacity(self.properties.len());
        for property in &self.properties {
            let PlyKind::Scalar(t) = property.kind else { return None };
            columns.push((at, t));
            at += t.bytes();
        }
        Some((columns, at))
    }
}

/// Encoding, elements, and where the rows begin.
pub(crate) fn parse(path: &Path, data: &[u8]) -> Result<(Encoding, Vec<Element>, usize), IoError> {
    let error = |message: &str| Err(IoError::format(path, message.to_string()));
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    loop {
        let rest = &data[at..];
        let Some(end) = rest.iter().take(1 << 12).position(|&b| b == b'\n') else {
            return error(
                "expected a PLY header that ends with 'end_header', found none; the file is no PLY or is damaged",
            );
        };
        let line = String::from_utf8_lossy(&rest[..end]);
        let words: Vec<&str> = line.split_whitespace().collect();
        if (at == 0) != (words == ["ply"]) {
            return error("expected a PLY file, which begins with the line 'ply'");
        }
        at += end + 1;
        match words[..] {
            ["ply"] | ["comment" | "obj_info", ..] | [] => {}
            ["format", "ascii", _] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", _] => encoding = Some(Encoding::LittleEndian),
            ["format", "binary_big_endian", _] => encoding = Some(Encoding::BigEndian),
            ["element", name, count] => match count.parse() {
                Ok(count) => elements.push(Element { name: name.into(), count, properties: Vec::new() }),
                Err(_) => return error(&format!("expected a number of rows in {line:?}")),
            },
            ["property", ref kind @ .., name] => match (parse_kind(kind), elements.last_mut()) {
                (Some(kind), Some(element)) if element.properties.len() < 1000 => {
                    element.properties.push(Property { name: name.into(), kind });
                }
                _ => return error(&format!("PLY header line {line:?} makes no sense")),
            },
            ["end_header"] => break,
            _ => return error(&format!("PLY header line {line:?} makes no sense")),
        }
    }
    match encoding {
        Some(encoding) => Ok((encoding, elements, at)),
        None => error("the PLY header has no known 'format' line"),
    }
}

fn parse_kind(words: &[&str]) -> Option<PlyKind> {
    match words {
        [t] => Scalar::from_name(t).map(PlyKind::Scalar),
        ["list", count, item] => Some(PlyKind::List(Scalar::from_name(count)?, Scalar::from_name(item)?)),
        _ => None,
    }
}
