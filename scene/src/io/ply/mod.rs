//! PLY files (Turk 1994): the header, and rows of any element by property name, in all three
//! encodings.

mod header;
mod points;
mod splat;

pub use points::{
    CloudPoint, OrientedPoint, parse_points_ply, read_points_ply, write_oriented_ply, write_points_ply,
};
pub(crate) use splat::decode_splat_ply;
pub use splat::{encode_splat_ply, read_splat_ply, write_splat_ply};

use super::error::IoError;
use header::{Element, Encoding, PlyKind, Scalar};
use std::path::Path;

/// Takes the number of a row and its values.
type EachRow<'a> = dyn FnMut(usize, &[f64]) -> Result<(), IoError> + 'a;

/// A parsed header and the bytes after it.
pub(crate) struct Ply<'a> {
    pub path: &'a Path,
    encoding: Encoding,
    elements: Vec<Element>,
    body: &'a [u8],
}

impl<'a> Ply<'a> {
    /// Parses the header; counts are checked when an element is read.
    pub(crate) fn parse(path: &'a Path, data: &'a [u8]) -> Result<Self, IoError> {
        let (encoding, elements, start) = header::parse(path, data)?;
        Ok(Self { path, encoding, elements, body: &data[start..] })
    }

    /// The element of that name.
    pub(crate) fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }

    /// Calls `each(row, values)` for every row of the element, with the wanted scalar properties in
    /// the wanted order. Every wanted property must exist.
    pub(crate) fn rows(
        &self,
        element: &str,
        wanted: &[&str],
        mut each: impl FnMut(usize, &[f64]) -> Result<(), IoError>,
    ) -> Result<(), IoError> {
        let mut body = self.body;
        for candidate in &self.elements {
            self.check_room(candidate, body)?;
            if candidate.name == element {
                let columns =
                    wanted.iter().map(|w| self.column(candidate, w)).collect::<Result<Vec<_>, _>>()?;
                return self.walk(candidate, &mut body, &columns, &mut each);
            }
            self.walk(candidate, &mut body, &[], &mut |_, _| Ok(()))?;
        }
        Err(IoError::format(
            self.path,
            format!("expected an element '{element}' in the PLY header, found none"),
        ))
    }

    /// Calls `each(row, items)` for every row of the element, with the items of its list that has
    /// one of the names.
    pub(crate) fn lists(
        &self,
        element: &str,
        names: &[&str],
        mut each: impl FnMut(usize, &[f64]) -> Result<(), IoError>,
    ) -> Result<(), IoError> {
        let mut body = self.body;
        for candidate in &self.elements {
            self.check_room(candidate, body)?;
            if candidate.name != element {
                self.walk(candidate, &mut body, &[], &mut |_, _| Ok(()))?;
                continue;
            }
            let mut found = false;
            let mut items = Vec::new();
            for row in 0..candidate.count as usize {
                for property in &candidate.properties {
                    match property.kind {
                        PlyKind::Scalar(t) => drop(self.next(t, &mut body)?),
                        PlyKind::List(count, item) => {
                            items.clear();
                            self.list(count, item, &mut body, &mut items)?;
                            if names.contains(&property.name.as_str()) {
                                found = true;
                                each(row, &items)?;
                            }
                        }
                    }
                }
            }
            if found || candidate.count == 0 {
                return Ok(());
            }
        }
        let message =
            format!("expected an element '{element}' with a list {}, found none", names.join(" or "));
        Err(IoError::format(self.path, message))
    }

    fn column(&self, element: &Element, name: &str) -> Result<usize, IoError> {
        let found =
            element.properties.iter().position(|p| p.name == name && matches!(p.kind, PlyKind::Scalar(_)));
        found.ok_or_else(|| {
            IoError::format(self.path, format!("element '{}' has no property '{name}'", element.name))
        })
    }

    fn check_room(&self, element: &Element, body: &[u8]) -> Result<(), IoError> {
        let row = if self.encoding == Encoding::Ascii {
            element.properties.len() as u64 * 2 - u64::from(!element.properties.is_empty())
        } else {
            element.properties.iter().map(|p| p.kind.min_bytes() as u64).sum()
        };
        let needed = element.count.saturating_mul(row.max(1));
        if needed > body.len() as u64 {
            let what = format!("element '{}' with {} rows", element.name, element.count);
            return Err(IoError::Truncated { path: self.path.into(), what, needed, left: body.len() as u64 });
        }
        Ok(())
    }

    fn walk(
        &self,
        element: &Element,
        body: &mut &[u8],
        columns: &[usize],
        each: &mut EachRow,
    ) -> Result<(), IoError> {
        let n = element.count as usize;
        let mut values = vec![0.0; columns.len()];
        if let Some(offsets) = element.fixed_offsets().filter(|_| self.encoding != Encoding::Ascii) {
            let (fixed, size) = offsets;
            let picked: Vec<(usize, Scalar)> = columns.iter().map(|&c| fixed[c]).collect();
            let little = self.encoding == Encoding::LittleEndian;
            for row in 0..n {
                let bytes = &body[row * size..(row + 1) * size];
                values.iter_mut().zip(&picked).for_each(|(v, &(at, t))| *v = t.decode(&bytes[at..], little));
                each(row, &values)?;
            }
            *body = &body[n * size..];
            return Ok(());
        }
        let mut all = vec![0.0; element.properties.len()];
        for row in 0..n {
            for (value, property) in all.iter_mut().zip(&element.properties) {
                *value = match property.kind {
                    PlyKind::Scalar(t) => self.next(t, body)?,
                    PlyKind::List(count, item) => self.list(count, item, body, &mut Vec::new())?,
                };
            }
            values.iter_mut().zip(columns).for_each(|(v, &c)| *v = all[c]);
            each(row, &values)?;
        }
        Ok(())
    }

    /// Appends the items of a list; their number.
    fn list(
        &self,
        count: Scalar,
        item: Scalar,
        body: &mut &[u8],
        items: &mut Vec<f64>,
    ) -> Result<f64, IoError> {
        let n = self.next(count, body)?;
        if !(0.0..=body.len() as f64).contains(&n) {
            return Err(self.cut_off());
        }
        for _ in 0..n as usize {
            items.push(self.next(item, body)?);
        }
        Ok(n)
    }

    fn cut_off(&self) -> IoError {
        IoError::Truncated { path: self.path.into(), what: "a row".into(), needed: 1, left: 0 }
    }

    /// The next value, in whichever encoding.
    fn next(&self, scalar: Scalar, body: &mut &[u8]) -> Result<f64, IoError> {
        if self.encoding != Encoding::Ascii {
            let size = scalar.bytes();
            if body.len() < size {
                return Err(self.cut_off());
            }
            let value = scalar.decode(body, self.encoding == Encoding::LittleEndian);
            *body = &body[size..];
            return Ok(value);
        }
        let start = body.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(|| self.cut_off())?;
        let rest = &body[start..];
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        *body = &rest[end..];
        let word = String::from_utf8_lossy(&rest[..end.min(40)]);
        word.parse().map_err(|_| IoError::format(self.path, format!("expected a number, found {word:?}")))
    }
}

#[cfg(test)]
pub(crate) use splat::tests::random_gaussians as test_gaussians;
