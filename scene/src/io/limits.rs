//! What a file may ask for before it is refused. Everything else is limited by the size of the file
//! itself.

/// The longest side of an image that is decoded, pixels. Source: the limit of JPEG (ITU-T T.81,
/// B.2.2).
pub(crate) const IMAGE_SIDE: u32 = 65_535;
/// The most decoded bytes of one image. Source: chosen by hand, never measured.
pub(crate) const IMAGE_BYTES: u64 = 1 << 30;
/// The most unpacked bytes of what a PNG holds beside its pixels, such as a colour profile.
/// Source: derived; the largest profiles in use (CMYK) have 3 MB.
pub(crate) const PNG_METADATA_BYTES: u64 = 1 << 24;
/// Most decoded bytes for each byte of a PNG, JPEG or TIFF. Source: derived; a code of 12 bits in
/// TIFF's LZW stands for 4,096 bytes at most, deflate packs 1,032 into one (RFC 1951).
pub(crate) const DECODED_RATIO: u64 = 4096;
/// More Gaussians than that are refused. Source: chosen by hand, never measured.
pub(crate) const GAUSSIANS: u32 = 1 << 26;
/// Most unpacked bytes for each packed one, where more than [`SMALL_BYTES`] are unpacked. Source:
/// derived; the quantised positions of a splat that was trained shrink by less than 2, the other
/// attributes, which may all be equal, are at most 55 of 64 bytes.
pub(crate) const UNPACKED_RATIO: u64 = 64;
/// So many bytes are unpacked whatever they were packed into. Source: derived; below what a process
/// needs to start.
pub(crate) const SMALL_BYTES: u64 = 1 << 20;

/// Whether a stream of `packed` bytes may unpack to `unpacked`.
pub(crate) fn may_unpack(packed: u64, unpacked: u64) -> bool {
    unpacked <= SMALL_BYTES.max(packed.saturating_mul(UNPACKED_RATIO))
}
