"""The few image formats the test bed needs, read and written with numpy and zlib alone."""

import struct
import zlib

import numpy as np

_LINES = {0: 1, 2: 1, 3: 16}  # scan lines in a chunk: no compression, ZIPS, ZIP
_TYPES = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}


def _header(data):
    """Attributes of a scan-line OpenEXR file as {name: bytes}, and where they end."""
    if data[:4] != b"\x76\x2f\x31\x01" or data[5] & 0x12:
        raise ValueError("not a single-part scan-line OpenEXR file")
    at, attributes = 8, {}
    while data[at] != 0:
        end = data.index(b"\0", at)
        name = data[at:end].decode()
        at = data.index(b"\0", end + 1) + 1
        (size,) = struct.unpack_from("<i", data, at)
        attributes[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return attributes, at + 1


def _channels(raw):
    """The channel list: [(name, dtype)], in file order."""
    at, found = 0, []
    while raw[at] != 0:
        end = raw.index(b"\0", at)
        (kind,) = struct.unpack_from("<i", raw, end + 1)
        found.append((raw[at:end].decode(), _TYPES[kind]))
        at = end + 17
    return found


def _unzip(block, size):
    """Undo OpenEXR's ZIP: inflate, undo the byte differences, join the two halves."""
    if len(block) == size:
        return block
    d = np.frombuffer(zlib.decompress(block), np.uint8).astype(np.int64)
    d[1:] -= 128
    d = (np.cumsum(d) & 255).astype(np.uint8)
    out, half = np.empty_like(d), (len(d) + 1) // 2
    out[0::2], out[1::2] = d[:half], d[half:]
    return out.tobytes()


def read_exr(path):
    """{channel: float32 [H, W]} of an OpenEXR file without compression or with ZIP."""
    with open(path, "rb") as file:
        data = file.read()
    attributes, at = _header(data)
    channels = _channels(attributes["channels"])
    x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    lines = _LINES[attributes["compression"][0]]
    line_bytes = sum(width * kind.itemsize for _, kind in channels)
    image = {name: np.empty((height, width), np.float32) for name, _ in channels}
    for (offset,) in struct.iter_unpack("<Q", data[at : at + 8 * -(-height // lines)]):
        y, size = struct.unpack_from("<2i", data, offset)
        y -= y0
        count = min(lines, height - y)
        block = _unzip(data[offset + 8 : offset + 8 + size], count * line_bytes)
        place = 0
        for row in range(y, y + count):
            for name, kind in channels:
                image[name][row] = np.frombuffer(block, kind, width, place)
                place += width * kind.itemsize
    return image


def write_png(path, pixels):
    """Write [H, W] or [H, W, 3], uint8 or uint16."""
    height, width = pixels.shape[:2]
    depth = 8 * pixels.dtype.itemsize
    rows = pixels.astype(">u2") if depth == 16 else pixels
    raw = np.ascontiguousarray(rows).reshape(height, -1).view(np.uint8)
    # PNG's filter 1 (difference to the left neighbour) makes mattes and depths compress well.
    step = pixels.dtype.itemsize * (pixels.shape[2] if pixels.ndim == 3 else 1)
    filtered = raw.copy()
    filtered[:, step:] -= raw[:, :-step]
    body = np.concatenate([np.ones((height, 1), np.uint8), filtered], 1).tobytes()

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">2I5B", width, height, depth, 2 if pixels.ndim == 3 else 0, 0, 0, 0)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head))
        file.write(chunk(b"IDAT", zlib.compress(body, 9)) + chunk(b"IEND", b""))


def read_png(path):
    """Read a grey PNG written by `write_png`: [H, W], uint8 or uint16."""
    with open(path, "rb") as file:
        data = file.read()
    width, height, depth = struct.unpack_from(">2IB", data, 16)
    (size,) = struct.unpack_from(">I", data, 33)
    step = depth // 8
    rows = np.frombuffer(zlib.decompress(data[41 : 41 + size]), np.uint8).reshape(height, 1 + width * step)
    if data[25] != 0 or (rows[:, 0] != 1).any():
        raise ValueError(f"{path}: not a grey PNG of the test bed")
    raw = np.cumsum(rows[:, 1:].reshape(height, width, step), axis=1, dtype=np.uint64).astype(np.uint8)
    return np.ascontiguousarray(raw).view(">u2")[..., 0].astype(np.uint16) if step == 2 else raw[..., 0]
