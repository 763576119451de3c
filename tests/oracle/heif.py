"""HEIC and AVIF photos and what libheif makes of them: scene/tests/fixtures/heif/*.heic, *.avif, each
with its upright pixels as .png.

python3 tests/oracle/heif.py [OUT]   (needs pillow-heif and Pillow with AVIF, both from PyPI)
"""

import io
import pathlib
import struct
import sys

import numpy as np
import pillow_heif
from PIL import Image

pillow_heif.register_heif_opener()
TILE = 64


def picture(width, height):
    """Smooth, and without any symmetry."""
    y, x = np.mgrid[:height, :width]
    rgb = [40 + 160 * x / width, 220 - 180 * y / height, 60 + 90 * (x + 2 * y) / (width + 2 * height)]
    return Image.fromarray(np.stack(rgb, -1).astype(np.uint8))


def metadata():
    """Focal length of 26 mm (of the 35 mm film), a place, and an orientation that HEIF says too."""
    exif = Image.Exif()
    exif[0x010F] = "Maker"
    exif.get_ifd(0x8769)[0xA405] = 26
    gps = exif.get_ifd(0x8825)
    gps.update({1: "N", 2: (52.0, 30.0, 0.0), 3: "E", 4: (13.0, 15.0, 0.0), 5: b"\0", 6: 34.5})
    exif[0x0112] = 6
    return exif


def box(kind, *parts):
    content = b"".join(parts)
    return struct.pack(">I4s", 8 + len(content), kind) + content


def full(kind, version, flags, *parts):
    return box(kind, struct.pack(">I", version << 24 | flags), *parts)


def boxes(data):
    at = 0
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        yield kind, data[at + 8:at + size]
        at += size


def coded(image):
    """hvcC and the coded bytes of a tile."""
    file = io.BytesIO()
    image.save(file, format="HEIF", quality=90)
    data = file.getvalue()
    meta = dict(boxes(dict(boxes(data))[b"meta"][4:]))
    properties = dict(boxes(dict(boxes(meta[b"iprp"]))[b"ipco"]))
    return properties[b"hvcC"], dict(boxes(data))[b"mdat"]


def grid(image):
    """A file as phones write it: tiles of one size, those at the border reach beyond the picture."""
    columns, rows = -(-image.width // TILE), -(-image.height // TILE)
    padded = Image.fromarray(np.pad(
        np.asarray(image), ((0, rows * TILE - image.height), (0, columns * TILE - image.width), (0, 0)),
        mode="edge"))
    tiles = [coded(padded.crop((c * TILE, r * TILE, (c + 1) * TILE, (r + 1) * TILE)))
             for r in range(rows) for c in range(columns)]
    assert len({hvcc for hvcc, _ in tiles}) == 1
    count, grid_item = len(tiles), len(tiles) + 1
    describe = struct.pack(">BBBBHH", 0, 0, rows - 1, columns - 1, image.width, image.height)
    entries = [full(b"infe", 2, 1, struct.pack(">HH4s", i + 1, 0, b"hvc1"), b"\0") for i in range(count)]
    entries.append(full(b"infe", 2, 0, struct.pack(">HH4s", grid_item, 0, b"grid"), b"\0"))
    size = [full(b"ispe", 0, 0, struct.pack(">II", *s)) for s in ((TILE, TILE), image.size)]
    colour = box(b"colr", b"nclx", struct.pack(">HHHB", 1, 13, 6, 0x80))
    properties = box(b"ipco", box(b"hvcC", tiles[0][0]), *size, colour)
    owned = [struct.pack(">HB3B", i + 1, 3, 0x81, 2, 4) for i in range(count)]
    owned.append(struct.pack(">HB2B", grid_item, 2, 3, 4))
    uses = full(b"ipma", 0, 0, struct.pack(">I", count + 1), *owned)
    parts = struct.pack(f">HH{count}H", grid_item, count, *range(1, count + 1))

    def meta(start):
        places, at = [], start
        for i, (_, data) in enumerate(tiles):
            places.append(struct.pack(">HHHHII", i + 1, 0, 0, 1, at, len(data)))
            at += len(data)
        places.append(struct.pack(">HHHHII", grid_item, 1, 0, 1, 0, len(describe)))
        handler = full(b"hdlr", 0, 0, struct.pack(">I4s12x", 0, b"pict"), b"\0")
        return full(
            b"meta", 0, 0, handler, full(b"pitm", 0, 0, struct.pack(">H", grid_item)),
            full(b"iloc", 1, 0, struct.pack(">BBH", 0x44, 0, count + 1), *places),
            full(b"iinf", 0, 0, struct.pack(">H", count + 1), *entries),
            full(b"iref", 0, 0, box(b"dimg", parts)), box(b"iprp", properties, uses),
            box(b"idat", describe))

    head = box(b"ftyp", b"heic", struct.pack(">I", 0), b"mif1heic")
    start = len(head) + len(meta(0)) + 8
    return head + meta(start) + box(b"mdat", *(data for _, data in tiles))


def main(out):
    out.mkdir(parents=True, exist_ok=True)
    stored = picture(96, 64)
    stored.info["exif"] = metadata().tobytes()
    stored.save(out / "turned.heic", quality=90)
    (out / "grid.heic").write_bytes(grid(picture(150, 100)))
    cut = picture(80, 60).convert("RGBA")
    alpha = np.zeros((60, 80), np.uint8)
    alpha[10:40, 20:70] = 255
    cut.putalpha(Image.fromarray(alpha))
    cut.save(out / "alpha.avif", quality=90)
    for name in ["turned.heic", "grid.heic", "alpha.avif"]:
        decoded = Image.open(out / name)
        decoded.load()
        print(name, decoded.size, decoded.mode, (out / name).stat().st_size, "bytes")
        decoded.save((out / name).with_suffix(".png"), exif=b"")


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else "scene/tests/fixtures/heif"))
