//! Boxes of an ISO base media file (ISO/IEC 14496-12, 4.2): big-endian values whose lengths are
//! checked before they are believed.

/// What is wrong with a file, in words.
pub(super) type Checked<T> = Result<T, String>;

/// A cursor over the content of a box.
#[derive(Clone, Copy)]
pub(super) struct Cursor<'a> {
    data: &'a [u8],
}

/// A box: its type and its content.
#[derive(Clone, Copy)]
pub(super) struct MediaBox<'a> {
    pub kind: [u8; 4],
    pub content: Cursor<'a>,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(data: &'a [u8]) -> Self {
        Self { data }
    }

    /// What is left.
    pub(super) fn rest(&self) -> &'a [u8] {
        self.data
    }

    /// The next `n` bytes.
    pub(super) fn take(&mut self, n: usize) -> Checked<&'a [u8]> {
        let cut = "the file is cut off or damaged";
        let (head, tail) = self.data.split_at_checked(n).ok_or_else(|| cut.to_owned())?;
        self.data = tail;
        Ok(head)
    }

    /// An unsigned number of `size` bytes, at most 8.
    pub(super) fn number(&mut self, size: usize) -> Checked<u64> {
        Ok(self.take(size.min(8))?.iter().fold(0, |n, &b| n << 8 | u64::from(b)))
    }

    /// An unsigned number of one byte.
    pub(super) fn byte(&mut self) -> Checked<u8> {
        Ok(self.take(1)?[0])
    }

    /// An unsigned number of 16 bits, or of 32 where `wide`.
    pub(super) fn id(&mut self, wide: bool) -> Checked<u32> {
        Ok(self.number(if wide { 4 } else { 2 })? as u32)
    }

    /// Version and flags at the start of a full box.
    pub(super) fn version(&mut self) -> Checked<(u8, u32)> {
        Ok((self.byte()?, self.number(3)? as u32))
    }

    /// A type of four characters.
    pub(super) fn kind(&mut self) -> Checked<[u8; 4]> {
        let mut kind = [0; 4];
        kind.copy_from_slice(self.take(4)?);
        Ok(kind)
    }

    /// The next box; `None` at the end.
    pub(super) fn next_box(&mut self) -> Checked<Option<MediaBox<'a>>> {
        if self.data.is_empty() {
            return Ok(None);
        }
        let (short, kind) = (self.number(4)?, self.kind()?);
        let length = match short {
            0 => self.data.len() as u64,
            1 => self.number(8)?.saturating_sub(16),
            n => n.checked_sub(8).ok_or("a box is shorter than its head")?,
        };
        let content = Self::new(self.take(usize::try_from(length).unwrap_or(usize::MAX))?);
        Ok(Some(MediaBox { kind, content }))
    }

    /// All boxes that are left.
    pub(super) fn boxes(mut self) -> Checked<Vec<MediaBox<'a>>> {
        let mut boxes = Vec::new();
        while let Some(next) = self.next_box()? {
            boxes.push(next);
        }
        Ok(boxes)
    }

    /// The content of the first box of this type.
    pub(super) fn find(self, kind: &[u8; 4]) -> Checked<Option<Self>> {
        Ok(self.boxes()?.into_iter().find(|b| b.kind == *kind).map(|b| b.content))
    }

    /// The same of a box that must be there.
    pub(super) fn need(self, kind: &[u8; 4]) -> Checked<Self> {
        self.find(kind)?.ok_or_else(|| format!("has no box `{}`", kind.escape_ascii()))
    }
}
