"""Odd files: sizes, formats, names, damaged and hostile content, folders that cannot be used."""
import base64
import ctypes
import json
import os
import struct
import zlib

import numpy as np

import photos
import scene
from photo_scenes import MODEL_OR_DOUBT

SCENES = {}
HERE = os.path.dirname(os.path.abspath(__file__))


def case(what, codes, *words, fast=True):
    def register(make):
        SCENES[make.__name__] = scene.Scene(what, codes, list(words), fast, make)
        return make

    return register


def of_size(made, height, width):
    return ["sfm", made.photos([photos.noise(made.rng, height, width) for _ in range(3)])]


@case("photos of 1 × 1 pixel", [1, 2])
def one_pixel(made):
    return of_size(made, 1, 1)


@case("photos of 1 × 200 pixels", [1, 2])
def one_column(made):
    return of_size(made, 200, 1)


@case("photos of 3000 × 1 pixels", [1, 2])
def one_row(made):
    return of_size(made, 1, 3000)


@case("photos of three sizes", [2], "no model")
def three_sizes(made):
    return ["sfm", made.photos([photos.noise(made.rng, h, w) for h, w in ((180, 240), (90, 300), (33, 17))])]


@case("photos of odd size", [0])
def odd_size(made):
    made.arc()
    for k in range(1, 9):
        made.ffmpeg("-i", made.path("photos", f"{k:03}.png"), "-vf", "crop=239:177:0:0", made.path("odd", f"{k:03}.png"))
    return ["sfm", made.path("odd")]


def converted(made, form, ending):
    made.arc()
    for k in range(1, 9):
        made.ffmpeg("-i", made.path("photos", f"{k:03}.png"), "-pix_fmt", form, made.path("converted", f"{k:03}.{ending}"))
    return ["sfm", made.path("converted")]


@case("grey photos of 8 bits", [0])
def grey_8(made):
    return converted(made, "gray", "png")


@case("grey photos of 16 bits", [0])
def grey_16(made):
    return converted(made, "gray16be", "png")


@case("colour photos of 16 bits", [0])
def colour_16(made):
    return converted(made, "rgb48be", "png")


@case("photos with an alpha channel that is opaque", [0])
def opaque_alpha(made):
    return converted(made, "rgba", "png")


@case("photos that are transparent", [2], "no model")
def transparent(made):
    pixels = [np.dstack([p, np.zeros(p.shape[:2], np.uint8)]) for p in made.pixels()]
    return ["sfm", made.photos(pixels)]


@case("JPEG of highest compression", MODEL_OR_DOUBT)
def coarse_jpeg(made):
    made.arc()
    for k in range(1, 9):
        made.ffmpeg("-i", made.path("photos", f"{k:03}.png"), "-q:v", "31", made.path("coarse", f"{k:03}.jpg"))
    return ["sfm", made.path("coarse")]


@case("a CMYK JPEG of something else among the photos", [3], "missing", "cmyk.jpg")
def cmyk(made):
    made.arc()
    with open(os.path.join(HERE, "cmyk.jpg.txt")) as file:
        made.write("photos/cmyk.jpg", base64.b64decode(file.read()))
    return ["sfm", made.path("photos")]


def jpegs(made, exif):
    """The arc as JPEG with an EXIF segment."""
    made.arc()
    for k in range(1, 9):
        plain = made.path("exif", f"{k:03}.jpg")
        made.ffmpeg("-i", made.path("photos", f"{k:03}.png"), "-q:v", "2", plain)
        with open(plain, "rb") as file:
            data = file.read()
        segment = b"\xff\xe1" + struct.pack(">H", len(exif) + 8) + b"Exif\0\0" + exif
        made.write(f"exif/{k:03}.jpg", data[:2] + segment + data[2:])
    return ["sfm", made.path("exif")]


def tiff(*entries):
    """A TIFF structure, little endian: entries (tag, kind, count, value) of one directory."""
    body = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + body + struct.pack("<I", 0)


@case("EXIF that is noise", [0])
def exif_noise(made):
    return jpegs(made, bytes(made.rng.randrange(256) for _ in range(200)))


@case("EXIF whose directory is itself", [0])
def exif_loop(made):
    return jpegs(made, tiff((0x8769, 4, 1, 8), (0x0112, 3, 1, 99)))


@case("EXIF with a focal length of 65,535 mm", [0])
def exif_focal(made):
    return jpegs(made, tiff((0x8769, 4, 1, 26)) + struct.pack("<HHHIII", 1, 0xA405, 3, 1, 65535, 0))


@case("EXIF with a focal length of 1/0", [0])
def exif_zero(made):
    return jpegs(made, tiff((0x8769, 4, 1, 26)) + struct.pack("<HHHIIIII", 1, 0x920A, 5, 1, 44, 0, 1, 0))


def with_file(made, name, content):
    made.arc()
    made.write("photos/" + name, content)
    return ["sfm", made.path("photos")]


def cut_off(made, ending, *flags):
    made.arc()
    target = made.path("photos", "cut." + ending)
    made.ffmpeg("-i", made.path("photos", "003.png"), *flags, target)
    os.truncate(target, os.path.getsize(target) // 2)
    return ["sfm", made.path("photos")]


@case("a JPEG that is cut off: half a picture", [0, 3])
def cut_jpeg(made):
    return cut_off(made, "jpg", "-q:v", "2")


@case("a PNG that is cut off", [0], "left out", "cut.png")
def cut_png(made):
    return cut_off(made, "png")


@case("an empty file among the photos", [0], "left out", "empty.jpg")
def empty_photo(made):
    return with_file(made, "empty.jpg", b"")


@case("text with the ending of a photo", [0], "left out", "text.png")
def text_photo(made):
    return with_file(made, "text.png", "no picture\n")


@case("a PNG named .jpg", [0])
def wrong_ending(made):
    made.arc()
    os.rename(made.path("photos/001.png"), made.path("photos/001.jpg"))
    return ["sfm", made.path("photos")]


@case("endings in capitals", [0])
def capitals(made):
    for path in made.arc():
        os.rename(path, path[:-3] + "PNG")
    return ["sfm", made.path("photos")]


def huge_png(width, height):
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes(100))
    return b"\x89PNG\r\n\x1a\n" + photos.chunk(b"IHDR", header) + photos.chunk(b"IDAT", data) + photos.chunk(b"IEND", b"")


@case("a PNG that claims 60,000 × 60,000 pixels", [0], "left out", "bomb.png")
def png_bomb(made):
    return with_file(made, "bomb.png", huge_png(60000, 60000))


@case("a PNG that claims 0 × 0 pixels", [0], "left out", "zero.png")
def png_of_nothing(made):
    return with_file(made, "zero.png", huge_png(0, 0))


@case("a PNG whose colour profile unpacks to 1 GiB", [0, 3], fast=False)
def profile_bomb(made):
    made.arc()
    with open(made.path("photos/002.png"), "rb") as file:
        data = file.read()
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(1024)) + packer.flush()
    made.write("photos/002.png", data[:33] + photos.chunk(b"iCCP", b"x\0\0" + packed) + data[33:])
    # Half of what it would need.
    made.more["preexec_fn"] = limited_memory
    return ["sfm", made.path("photos"), "--threads", "1"]


def limited_memory():
    import resource

    resource.setrlimit(resource.RLIMIT_DATA, (512 << 20, 512 << 20))


@case("photos whose names are Unicode", [0])
def unicode_names(made):
    for path, name in zip(made.arc(known=False), ["é", "日本", "ß", "Ω", "☃", "e\u0301x", "😀", "\u202eabc"]):
        os.rename(path, made.path("photos", name + ".png"))
    return ["sfm", made.path("photos")]


@case("photos whose names are code, flags and spaces", [0])
def hostile_names(made):
    names = ["<script>alert(1)<", "-rf", "a b", "\"quoted\"", "%2e%2e", "new\nline", "$(id)", "'; drop"]
    for path, name in zip(made.arc(known=False), names):
        os.rename(path, made.path("photos", name.replace("/", "_") + ".png"))
    return ["sfm", made.path("photos")]


@case("a photo whose name is not UTF-8", [0], "left out", "not text")
def odd_name(made):
    os.rename(made.arc()[0].encode(), made.path("photos/").encode() + b"\xff\xfe.png")
    return ["sfm", made.path("photos")]


@case("a photo whose name has 250 characters", [0])
def long_name(made):
    os.rename(made.arc(known=False)[7], made.path("photos", "x" * 246 + ".png"))
    return ["sfm", made.path("photos")]


@case("a folder named like a photo", [0, 1])
def folder_named_like_a_photo(made):
    made.arc()
    os.makedirs(made.path("photos/folder.png"))
    return ["sfm", made.path("photos")]


@case("a pipe named like a photo", [0, 1])
def pipe(made):
    made.arc()
    os.mkfifo(made.path("photos/pipe.png"))
    return ["sfm", made.path("photos")]


@case("a link to an endless device named like a photo", [0, 1])
def endless_device(made):
    made.arc()
    os.symlink("/dev/zero", made.path("photos/zero.png"))
    made.more["preexec_fn"] = limited_memory
    return ["sfm", made.path("photos")]


@case("a link to an endless device named like a video", [1], "zero.mp4")
def endless_video(made):
    os.symlink("/dev/zero", made.path("zero.mp4"))
    return ["sfm", made.path("zero.mp4")]


@case("folders that link to each other", [1], "photos")
def link_loop(made):
    os.makedirs(made.path("photos"), exist_ok=True)
    os.symlink(".", made.path("photos/again"))
    return ["sfm", made.path("photos")]


@case("an empty folder", [1], "photos")
def empty_folder(made):
    os.makedirs(made.path("photos"))
    return ["sfm", made.path("photos")]


@case("a folder without a photo", [1], "photos")
def no_photo(made):
    made.write("photos/readme.txt", "no photo")
    return ["sfm", made.path("photos")]


@case("no input", [1], "no/such.mp4")
def no_input(made):
    return ["sfm", "no/such.mp4"]


@case("an output that is a file", [1], "taken")
def output_is_a_file(made):
    made.arc()
    return ["sfm", made.path("photos"), "-o", made.write("taken", "mine")]


@case("an output in a folder that may not be written", [1], "readonly")
def read_only_output(made):
    made.arc()
    os.makedirs(made.path("readonly"))
    os.chmod(made.path("readonly"), 0o555)
    hold_root_back(made)
    return ["sfm", made.path("photos"), "-o", made.path("readonly/out")]


@case("a photo that may not be read", [0], "left out", "004.png")
def unreadable_photo(made):
    os.chmod(made.arc()[3], 0)
    hold_root_back(made)
    return ["sfm", made.path("photos")]


def hold_root_back(made):
    """Permissions hold root back without these capabilities, and its own files stay within reach."""
    if os.geteuid() == 0:
        made.more["preexec_fn"] = drop_capabilities


def drop_capabilities():
    """CAP_DAC_OVERRIDE (1) and CAP_DAC_READ_SEARCH (2) are lost at the next exec (capabilities(7))."""
    libc = ctypes.CDLL(None, use_errno=True)
    for capability in (1, 2):
        if libc.prctl(24, capability, 0, 0, 0):  # PR_CAPBSET_DROP of linux/prctl.h
            raise OSError(ctypes.get_errno(), "prctl")


@case("an output folder with the photos of others", [1], "not written by sat-recon")
def foreign_output(made):
    made.arc()
    made.write("out/images/mine.png", b"mine")
    return ["sfm", made.path("photos")]


@case("an empty video", [1], "empty.mp4")
def empty_video(made):
    return ["sfm", made.write("empty.mp4", b"")]


@case("a video that is cut off", [0, 2, 3])
def cut_video(made):
    with open(os.path.join(scene.SOURCES["data"], "sample/orbit.mp4"), "rb") as file:
        return ["sfm", made.write("cut.mp4", file.read()[:200000]), "--frames", "8", "--max-size", "240"]


@case("a video without its beginning", [1], "headless.mp4")
def headless_video(made):
    with open(os.path.join(scene.SOURCES["data"], "sample/orbit.mp4"), "rb") as file:
        return ["sfm", made.write("headless.mp4", file.read()[50000:])]


@case("a video of sound alone", [1], "sound.mp4")
def sound(made):
    made.ffmpeg("-f", "lavfi", "-i", "sine=duration=1", made.path("sound.mp4"))
    return ["sfm", made.path("sound.mp4")]


@case("a playlist named like a video", [1], "list.mp4")
def playlist(made):
    film = os.path.join(scene.SOURCES["data"], "sample/orbit.mp4")
    return ["sfm", made.write("list.mp4", f"#EXTM3U\n#EXTINF:6,\nfile://{film}\n#EXT-X-ENDLIST\n")]


def transforms(made, content):
    made.arc()
    os.rename(made.path("photos"), made.path("set/images"))
    made.write("set/transforms.json", content)
    return ["sfm", made.path("set")]


@case("transforms.json that is empty", [1], "transforms.json")
def empty_json(made):
    return transforms(made, "")


@case("transforms.json of a hundred thousand brackets", [1], "transforms.json")
def deep_json(made):
    return transforms(made, "[" * 100000)


@case("transforms.json without a frame", [1], "transforms.json")
def no_frames(made):
    return transforms(made, json.dumps({"w": 240, "h": 180, "fl_x": 200, "frames": []}))


@case("transforms.json with a focal length of 0", [1], "transforms.json")
def no_focal(made):
    frame = {"file_path": "images/001.png", "transform_matrix": np.eye(4).tolist()}
    return transforms(made, json.dumps({"w": 240, "h": 180, "fl_x": 0, "frames": [frame] * 2}))


@case("a COLMAP model that claims 2^62 images", [1], "images.bin")
def huge_count(made):
    made.arc()
    os.rename(made.path("photos"), made.path("set/images"))
    made.write("set/sparse/0/cameras.bin", struct.pack("<QIiQQ4d", 1, 1, 1, 240, 180, 200, 200, 120, 90))
    made.write("set/sparse/0/images.bin", struct.pack("<Q", 1 << 62))
    made.write("set/sparse/0/points3D.bin", struct.pack("<Q", 0))
    return ["sfm", made.path("set")]
