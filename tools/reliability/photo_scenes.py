"""Degenerate scenes in photos and videos of the right form: nothing to see, nothing that moves,
two things at once, poses that cannot be."""
import json
import os
import shutil

import numpy as np

import colmap
import harness
import photos
import scene

SCENES = {}
MODEL_OR_DOUBT = [0, 2, 3]  # with exit code 0 the poses must be right


def case(what, codes, *words, fast=True):
    def register(make):
        SCENES[make.__name__] = scene.Scene(what, codes, list(words), fast, make)
        return make

    return register


def flat(value, count=4):
    return [np.full((180, 240, 3), value, np.uint8)] * count


@case("one photo", [1], "photos", "at least 2")
def one_photo(made):
    made.arc(1)
    return [made.path("photos")]


@case("two photos 5° apart", MODEL_OR_DOUBT)
def two_photos(made):
    made.arc(2)
    return ["sfm", made.path("photos")]


@case("two equal photos", [2], "no model")
def two_equal_photos(made):
    return ["sfm", made.photos(made.pixels(1).repeat(2, 0))]


@case("eight equal photos", [2], "no model")
def equal_photos(made):
    return ["sfm", made.photos(made.pixels(1).repeat(8, 0))]


@case("black photos", [2], "no model")
def black(made):
    return ["sfm", made.photos(flat(0))]


@case("white photos", [2], "no model")
def white(made):
    return ["sfm", made.photos(flat(255))]


@case("photos of one grey", [2], "no model")
def grey(made):
    return ["sfm", made.photos(flat(128))]


@case("noise", [2], "no model")
def noise(made):
    return ["sfm", made.photos([photos.noise(made.rng, 180, 240) for _ in range(4)])]


@case("a smooth gradient that moves", [2], "no model")
def gradient(made):
    x = np.arange(240)[None, :, None] * np.ones((180, 1, 3))
    return ["sfm", made.photos([((x + 9 * k) % 256).astype(np.uint8) for k in range(4)])]


@case("a repeated pattern that moves", [2, 3])
def repeated_pattern(made):
    tile = photos.noise(made.rng, 20, 20)
    wall = np.tile(tile, (12, 16, 1))
    return ["sfm", made.photos([wall[:180, 7 * k : 240 + 7 * k] for k in range(8)])]


def moved(picture, H):
    """The picture at H times each pixel's place, nearest."""
    height, width = picture.shape[:2]
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    p = np.stack([x, y, np.ones_like(x)], -1) @ np.asarray(H, float).T
    u, v = (np.rint(p[..., k] / p[..., 2]).astype(int) for k in (0, 1))
    return picture[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)]


@case("a poster that slides past: all in one plane", [0, 2, 3])
def plane(made):
    picture = made.pixels(1)[0]
    return ["sfm", made.photos([moved(picture, [[1, 0, 6 * k], [0, 1, 2 * k], [0, 0, 1]]) for k in range(8)])]


@case("a camera that turns in one place", [2, 3])
def pure_rotation(made):
    picture, K = made.pixels(1)[0], np.array([[200, 0, 120], [0, 200, 90], [0, 0, 1.0]])
    turns = [colmap.rotation([1, 0, np.tan(np.radians(2 * k)), 0]) for k in range(8)]
    return ["sfm", made.photos([moved(picture, K @ R @ np.linalg.inv(K)) for R in turns])]


@case("a poster that comes nearer, or a zoom: nothing tells them apart", [0, 2, 3])
def zoom(made):
    picture = made.pixels(1)[0]
    scaled = lambda s: moved(picture, [[s, 0, 120 * (1 - s)], [0, s, 90 * (1 - s)], [0, 0, 1]])
    return ["sfm", made.photos([scaled(1 - 0.06 * k) for k in range(8)])]


@case("saturated photos", MODEL_OR_DOUBT)
def saturated(made):
    made.arc()
    made.photos(np.clip(made.pixels().astype(int) * 5, 0, 255).astype(np.uint8), "{:03}.png")
    return bare(made)


@case("photos at a sixteenth of the light", MODEL_OR_DOUBT)
def dark(made):
    made.arc()
    made.photos(made.pixels() // 16, "{:03}.png")
    return bare(made)


def bare(made):
    """Photos written from 000 on, in the place of the frames 001 on."""
    names = sorted(os.listdir(made.path("photos")))
    made.frames = {f"{k:03}": k for k in range(8)}
    os.remove(made.path("photos", names[-1]))
    return ["sfm", made.path("photos")]


@case("photos blurred over 9 pixels", MODEL_OR_DOUBT)
def blurred(made):
    made.arc()
    for k in range(1, 9):
        made.ffmpeg("-i", made.path("photos", f"{k:03}.png"), "-vf", "boxblur=4:2", made.path("blurred", f"{k:03}.png"))
    return ["sfm", made.path("blurred")]


@case("noise as strong as the picture", MODEL_OR_DOUBT)
def noisy(made):
    made.arc()
    noise_ = np.random.default_rng(1).normal(0, 60, (8, 180, 240, 3))
    made.photos(np.clip(made.pixels() + noise_, 0, 255).astype(np.uint8), "{:03}.png")
    return bare(made)


@case("half of the photos mirrored", MODEL_OR_DOUBT)
def half_mirrored(made):
    made.arc()
    made.photos([p[:, ::-1] if k % 2 else p for k, p in enumerate(made.pixels())], "{:03}.png")
    return bare(made)


@case("half of the photos upside down", MODEL_OR_DOUBT)
def half_upside_down(made):
    pixels = made.pixels()
    return ["sfm", made.photos([p[::-1, ::-1] if k % 2 else p for k, p in enumerate(pixels)])]


@case("photos in disorder", [0])
def disorder(made):
    made.arc()
    for k, other in enumerate([4, 1, 7, 2, 8, 3, 6, 5]):
        os.rename(made.path("photos", f"{other:03}.png"), made.path("shuffled", f"x{k}.png"))
        made.frames[f"x{k}"] = other - 1
    return ["sfm", made.path("shuffled")]


@case("photos of two objects", [2, 3])
def two_objects(made):
    both = [*made.pixels(), *made.pixels(source="other")]
    return ["sfm", made.photos(both)]


@case("seven photos and one of something else", [3], "missing")
def one_foreign_photo(made):
    return ["sfm", made.photos([*made.pixels(7), made.pixels(1, "other")[0]])]


@case("a video with a cut between two scenes", [2, 3], fast=False)
def cut(made):
    both = [os.path.join(scene.SOURCES["data"], f) for f in ("sample/orbit.mp4", "testbed/case3/video.mp4")]
    parts = [f"[{k}:v]scale=240:180,setsar=1,fps=6,trim=end_frame=12,setpts=PTS-STARTPTS[v{k}]" for k in (0, 1)]
    film = made.path("cut.mp4")
    made.ffmpeg("-i", both[0], "-i", both[1], "-filter_complex", ";".join(parts) + ";[v0][v1]concat=n=2[v]", "-map", "[v]", film)
    return ["sfm", film, "--key", "off"]


@case("a video of a turn with a hard cut in it", [2, 3], fast=False)
def cut_in_a_turn(made):
    film = os.path.join(scene.SOURCES["data"], "testbed/case3/video.mp4")
    kept = "select='lt(n,54)+gte(n,129)',setpts=N/FRAME_RATE/TB"
    made.ffmpeg("-i", film, "-vf", kept, "-crf", "14", "-pix_fmt", "yuv420p", made.path("turn.mp4"))
    return ["sfm", made.path("turn.mp4")]


@case("a video of one frame", [1], "one.mp4")
def video_of_one_frame(made):
    made.ffmpeg("-i", os.path.join(scene.SOURCES["arc"], "001.png"), "-pix_fmt", "yuv420p", made.path("one.mp4"))
    return ["sfm", made.path("one.mp4")]


@case("a video that stands still", [1], "still.mp4", "move the camera")
def still_video(made):
    made.ffmpeg("-loop", "1", "-i", os.path.join(scene.SOURCES["arc"], "001.png"), "-t", "2", "-pix_fmt", "yuv420p", made.path("still.mp4"))
    return ["sfm", made.path("still.mp4")]


@case("a black video", [1], "black.mp4", "move the camera")
def black_video(made):
    made.ffmpeg("-f", "lavfi", "-i", "color=black:size=160x120:rate=10:duration=2", "-pix_fmt", "yuv420p", made.path("black.mp4"))
    return ["sfm", made.path("black.mp4")]


@case("a video of 2 × 2 pixels", [1, 2])
def tiny_video(made):
    made.ffmpeg("-f", "lavfi", "-i", "testsrc=size=2x2:rate=10:duration=1", "-pix_fmt", "yuv420p", made.path("tiny.mp4"))
    return ["sfm", made.path("tiny.mp4")]


@case("a video of varying rate", [0], fast=False)
def varying_rate(made):
    film = os.path.join(scene.SOURCES["data"], "sample/orbit.mp4")
    rate = "scale=240:180,setpts='if(lt(N,36),N/12,3+(N-36)/5)/TB'"
    made.ffmpeg("-i", film, "-vf", rate, "-fps_mode", "vfr", made.path("varying.mp4"))
    return ["sfm", made.path("varying.mp4"), "--frames", "36"]


def posed(made, change):
    """A COLMAP model of the true poses beside the photos, without points, changed."""
    made.arc()
    os.rename(made.path("photos"), made.path("set/images"))
    with open(os.path.join(scene.SOURCES["data"], "sample/orbit_truth/images.txt")) as file:
        lines = [line.split() for line in file if line.strip() and not line.startswith("#")][:8]
    images = {k: {"q": [float(v) for v in w[1:5]], "t": [float(v) for v in w[5:8]], "camera": 1, "name": f"{k:03}.png", "seen": []}
              for k, w in enumerate(lines, 1)}
    model = {"cameras": {1: ["SIMPLE_RADIAL", 240, 180, [200.0, 121.5, 88.6, -0.03]]}, "images": images, "points": {}}
    change(model)
    colmap.write_text(model, made.path("set/sparse/0"))
    return ["sfm", made.path("set")]


def scaled(factor):
    def change(model):
        for image in model["images"].values():
            image["t"] = [v * factor for v in image["t"]]
    return change


def each(change):
    return lambda model: [change(image) for image in model["images"].values()]


@case("true poses", [0])
def true_poses(made):
    return posed(made, scaled(1))


@case("true poses in a world a million times larger", [0])
def large_world(made):
    return posed(made, scaled(1e6))


@case("true poses in a world a million times smaller", [0])
def small_world(made):
    return posed(made, scaled(1e-6))


@case("a world of 1e12 units", [1], "farther away than")
def huge_world(made):
    return posed(made, scaled(1e12))


@case("poses that are NaN", [1], "images.txt", "finite")
def nan_poses(made):
    return posed(made, each(lambda image: image["t"].__setitem__(1, float("nan"))))


@case("poses that are all equal", [1], "same pose")
def equal_poses(made):
    def change(model):
        for image in model["images"].values():
            image["q"], image["t"] = model["images"][1]["q"], model["images"][1]["t"]
    return posed(made, change)


@case("rotations of length 0", [1], "images.txt", "quaternion")
def no_rotations(made):
    return posed(made, each(lambda image: image.__setitem__("q", [0, 0, 0, 0])))


@case("poses of other photos", [1, 3], "photo")
def poses_of_other_photos(made):
    def change(model):
        poses = [(i["q"], i["t"]) for i in model["images"].values()]
        for image, pose in zip(model["images"].values(), [poses[k] for k in (3, 6, 1, 7, 0, 2, 5, 4)]):
            image["q"], image["t"] = pose
    return posed(made, change)


@case("poses for one of eight photos", [1], "at least 2")
def one_pose(made):
    return posed(made, lambda model: [model["images"].pop(k) for k in range(2, 9)])


@case("poses for seven of eight photos", [3], "missing", "008.png")
def seven_poses(made):
    return posed(made, lambda model: model["images"].pop(8))


@case("a model without an image", [1], "set")
def no_images(made):
    return posed(made, lambda model: model["images"].clear())


@case("black masks", [2], "no model")
def all_masked(made):
    made.arc()
    for k in range(1, 9):
        photos.write_png(made.path("masks", f"{k:03}.png"), np.zeros((180, 240), np.uint8))
    return ["sfm", made.path("photos"), "--masks", made.path("masks")]


@case("white masks", [0])
def none_masked(made):
    made.arc()
    for k in range(1, 9):
        photos.write_png(made.path("masks", f"{k:03}.png"), np.full((180, 240), 255, np.uint8))
    return ["sfm", made.path("photos"), "--masks", made.path("masks")]


@case("a mask of another size", [0], "mask left out", "003.png")
def mask_of_another_size(made):
    made.arc()
    for k in range(1, 9):
        photos.write_png(made.path("masks", f"{k:03}.png"), np.full((90 if k == 3 else 180, 240), 255, np.uint8))
    return ["sfm", made.path("photos"), "--masks", made.path("masks")]


@case("transforms.json with a matrix that is no pose", [1], "transforms.json")
def matrix_of_no_pose(made):
    made.arc()
    os.rename(made.path("photos"), made.path("set/images"))
    frame = lambda k: {"file_path": f"images/{k:03}.png", "transform_matrix": [[2, 1, 0, k], [0, 3, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]]}
    made.write("set/transforms.json", json.dumps({"w": 240, "h": 180, "fl_x": 200, "frames": [frame(k) for k in range(1, 9)]}))
    return ["sfm", made.path("set")]


@case("a finished run whose images were deleted is made again", [0], "made again")
def deleted_images(made):
    made.arc()
    run = made.path("out")
    done = harness.run(made.program, ["sfm", made.path("photos"), "-o", run])
    if done["code"] == 0:
        shutil.rmtree(os.path.join(run, "images"))
    return ["sfm", made.path("photos"), "-o", run]
