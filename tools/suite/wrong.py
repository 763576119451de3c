#!/usr/bin/env python3
"""Makes the made-wrong set: captures of which no right model, or hardly one, can be made.

    wrong.py SHARED [NAME ...] [--cache FOLDER] [--list]

Each is a folder CACHE/wrong/NAME with `images/` or `video.mp4`, `case.json` and one COLMAP text
model for each truth in `truths/`; what it is made of (captures of the suite) is filmed first where
it is missing. case.json holds
    why      what is wrong with it
    asked    "right": if the program says that all is well, the model must be right by one truth
             "doubt": whatever it makes, it must refuse, or say that the model is doubtful
"""
import argparse
import json
import os
import random
import shutil
import subprocess
import sys

import numpy as np
from PIL import Image

import captures
import film
import suite
import truth
import wrong_images as images_of

CASES = {}


def case(asked, why, half="A"):
    """Registers a function that fills a folder and returns {truth: (camera line, {stem: pose})};
    `half`: that of its objects."""
    def register(make):
        CASES[make.__name__] = (make, asked, why, half)
        return make
    return register


class Source:
    """Captures and real data that the cases are made of."""

    def __init__(self, cache, shared):
        self.cache, self.shared = cache, shared

    def film(self, name):
        """Folder of a capture, filmed where it is missing."""
        return film.film(captures.parse(name), self.cache, self.shared)[0]

    def photos(self, name):
        """(paths of the photos, camera line, {stem: pose}) of a capture of photos."""
        folder = self.film(name)
        files = sorted(os.path.join(folder, "images", n) for n in os.listdir(os.path.join(folder, "images")))
        return files, *images_of.read_truth(os.path.join(folder, "sparse"))

    def frames(self, name):
        """([n, H, W, 3], camera line, [pose], frames a second) of a capture on video."""
        folder = self.film(name)
        camera, poses = images_of.read_truth(os.path.join(folder, "sparse"))
        fps = captures.parse(name).fps
        return images_of.decode(os.path.join(folder, "video.mp4")), camera, [poses[n] for n in sorted(poses)], fps

    def real(self, images, poses):
        """(paths, camera line, {stem: pose}) of a real set below SHARED/data."""
        sys.path.insert(0, os.path.join(self.shared, "tools"))
        import compare_poses

        folder = os.path.join(self.shared, "data", images)
        found = compare_poses.read_ground_truth(os.path.join(self.shared, "data", poses))
        stems = {os.path.splitext(os.path.basename(n))[0]: (p.R, p.t) for n, p in found.items()}
        files = sorted(os.path.join(folder, n) for n in os.listdir(folder))
        return files, "PINHOLE 1 1 1 1 0 0", stems


def stem(path):
    return os.path.splitext(os.path.basename(path))[0]


def shuffle_together(folder, sets, seed):
    """Copies photos of several sets under names in random order; {set: (camera, {name: pose})}."""
    entries = [(which, path) for which, (files, _, _) in sets.items() for path in files]
    random.Random(seed).shuffle(entries)
    truths = {which: (camera, {}) for which, (_, camera, _) in sets.items()}
    for k, (which, path) in enumerate(entries):
        name = f"photo_{k:03d}"
        images_of.copy_photo(path, os.path.join(folder, "images", name + ".jpg"))
        pose = sets[which][2].get(stem(path))
        if pose is not None:
            truths[which][1][name] = pose
    return truths


@case("right", "photos of two objects, each in a room of its own, shuffled together")
def two_objects(source, folder):
    sets = {"statue": source.photos("statue-orbit-full"), "product": source.photos("product-orbit-full")}
    return shuffle_together(folder, sets, 1)


@case("right", "photos of two objects on black, shuffled together")
def two_objects_black(source, folder):
    sets = {"microphone": source.photos("microphone-stand-full"), "twins": source.photos("twins-stand-full")}
    return shuffle_together(folder, sets, 2)


@case("right", "real photos of two objects, shuffled together")
def two_objects_real(source, folder):
    files, camera, poses = source.real("lego400/images", "lego400/transforms.json")
    sets = {"temple": source.real("temple_ring/images", "temple_ring/cameras_par.txt"), "lego": (files[::3], camera, poses)}
    return shuffle_together(folder, sets, 3)


def mirror_half(folder, files, camera, poses, seed):
    """Half of the photos mirrored left to right; the mirrored ones see a mirrored object."""
    flip = np.diag([-1.0, 1.0, 1.0])
    mirrored = set(random.Random(seed).sample(files, len(files) // 2))
    truths = {"plain": (camera, {}), "mirrored": (camera, {})}
    for path in files:
        images_of.copy_photo(path, os.path.join(folder, "images", stem(path) + ".jpg"), mirrored=path in mirrored)
        R, t = poses[stem(path)]
        if path in mirrored:
            truths["mirrored"][1][stem(path)] = (flip @ R @ flip, flip @ t)
        else:
            truths["plain"][1][stem(path)] = (R, t)
    return truths


@case("right", "half of the photos of a statue mirrored")
def mirrored(source, folder):
    return mirror_half(folder, *source.photos("statue-orbit-full"), 4)


@case("right", "half of the real photos of an object mirrored")
def mirrored_real(source, folder):
    return mirror_half(folder, *source.real("temple_ring/images", "temple_ring/cameras_par.txt"), 5)


def as_they_are(folder, files, camera, poses):
    for path in files:
        images_of.copy_photo(path, os.path.join(folder, "images", os.path.basename(path)))
    return {"object": (camera, poses)}


@case("right", "an object on a turntable in a textured room that stands still, no masks")
def still_room(source, folder):
    return as_they_are(folder, *source.photos("product-stage-full"))


@case("right", "a dark bust without texture on a turntable before black", "B")
def textureless(source, folder):
    return as_they_are(folder, *source.photos("bust-stand-full"))


@case("right", "a microphone on a turntable before black: thin parts, a mesh that repeats")
def repeated_mesh(source, folder):
    return as_they_are(folder, *source.photos("microphone-stand-full"))


@case("right", "a carton whose four sides show the same print")
def repeated_sides(source, folder):
    return as_they_are(folder, *source.photos("twins-stand-full"))


@case("right", "an object that was moved in its room half-way through the photos")
def moved_object(source, folder):
    files, camera, poses = source.photos("statue-moved-full")
    with open(os.path.join(source.film("statue-moved-full"), "motion.json")) as file:
        room = json.load(file)["camera_from_room"]
    truths = as_they_are(folder, files, camera, poses)
    return truths | {"room": (camera, {n: (np.array(R), np.array(t)) for n, (R, t) in zip(sorted(poses), room)})}


@case("doubt", "a camera that turns about its own centre: no depth can be known")
def pure_rotation(source, folder):
    photo = os.path.join(source.shared, "data/fountain_p11/images")
    path = os.path.join(photo, sorted(os.listdir(photo))[5])
    return images_of.rotate_about_centre(folder, path, 24)


@case("doubt", "the same photo twenty times")
def same_photo(source, folder):
    files, _, _ = source.photos("statue-orbit-full")
    for k in range(20):
        images_of.copy_photo(files[0], os.path.join(folder, "images", f"photo_{k:03d}.jpg"))
    return {}


def noisy_copies(folder, photo):
    """The same photo twenty times, each with noise of its own."""
    picture = np.asarray(Image.open(photo)).astype(float)
    for k in range(20):
        noisy = picture + np.random.default_rng(k).normal(0, 3, picture.shape)
        images_of.save(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), os.path.join(folder, "images", f"photo_{k:03d}.jpg"))
    return {}


@case("doubt", "a camera that stands still before an object that stands still, twenty photos with noise")
def nothing_moves(source, folder):
    files, _, _ = source.photos("statue-orbit-full")
    return noisy_copies(folder, files[3])


@case("right", "photos whose EXIF says 70 mm where the lens has about 30 mm")
def wrong_exif(source, folder):
    truths = as_they_are(folder, *source.photos("statue-orbit-full"))
    for name in os.listdir(os.path.join(folder, "images")):
        images_of.write_focal_exif(os.path.join(folder, "images", name), 70)
    return truths


def of_frames(folder, pictures, fps, camera, poses):
    """A video of these frames; their truth by the names that sat-recon gives frames."""
    images_of.encode(os.path.join(folder, "video.mp4"), pictures, fps)
    return {"object": (camera, {f"frame_{k:06d}": p for k, p in enumerate(poses) if p is not None})}


@case("right", "a video with a cut: an object, then another")
def cut_two_objects(source, folder):
    a, camera, first, fps = source.frames("mockup-yaw-full-4")
    b, other, second, _ = source.frames("mockup-tumble-sun-15")
    n, m = 72, 90
    truths = of_frames(folder, np.concatenate([a[:n], b[:m]]), fps, camera, [*first[:n], *[None] * m])
    return truths | {"other": (other, {f"frame_{n + k:06d}": p for k, p in enumerate(second[:m])})}


@case("right", "a video with a cut: the same turn goes on 150 degrees later")
def cut_same_object(source, folder):
    a, camera, poses, fps = source.frames("mockup-yaw-full-4")
    keep = [*range(0, 40), *range(100, 144)]
    return of_frames(folder, a[keep], fps, camera, [poses[k] for k in keep])


@case("right", "a turn of only 40 degrees")
def short_turn(source, folder):
    a, camera, poses, fps = source.frames("mockup-hand-full-15")
    with open(os.path.join(source.film("mockup-hand-full-15"), "motion.json")) as file:
        angles = json.load(file)["angles_deg"]
    keep = [k for k, angle in enumerate(angles) if angle <= 40]
    return of_frames(folder, a[keep], fps, camera, [poses[k] for k in keep])


@case("right", "a turn of 200 degrees that goes back on the same way")
def forth_and_back(source, folder):
    a, camera, poses, fps = source.frames("mockup-yaw-full-4")
    keep = [*range(0, 80), *range(79, -1, -1)]
    return of_frames(folder, a[keep], fps, camera, [poses[k] for k in keep])


@case("right", "two objects side by side that turn differently")
def two_turns(source, folder):
    a, camera, first, fps = source.frames("mockup-yaw-full-4")
    b, other, second, _ = source.frames("mockup-hand-full-15")
    n = len(a)
    back = [len(b) - 1 - round(k * (len(b) - 1) / (n - 1)) for k in range(n)]
    both = images_of.side_by_side(a, b[back])
    truths = of_frames(folder, both, fps, camera, first)
    return truths | {"other": (other, {f"frame_{k:06d}": second[j] for k, j in enumerate(back)})}


@case("right", "photos of two objects, each in a room of its own, shuffled together", "B")
def two_objects_b(source, folder):
    sets = {"chair": source.photos("chair-orbit-full"), "hubble": source.photos("hubble-orbit-sun")}
    return shuffle_together(folder, sets, 6)


@case("right", "half of the photos of a chair mirrored", "B")
def mirrored_b(source, folder):
    return mirror_half(folder, *source.photos("chair-orbit-full"), 7)


@case("right", "half of the photos of a product mirrored")
def mirrored_product(source, folder):
    return mirror_half(folder, *source.photos("product-orbit-full"), 9)


@case("right", "half of the photos of a spacecraft mirrored")
def mirrored_craft(source, folder):
    return mirror_half(folder, *source.photos("mockup-orbit-full"), 10)


@case("right", "half of the photos of a carton mirrored, before black")
def mirrored_black(source, folder):
    return mirror_half(folder, *source.photos("twins-stand-full"), 11)


@case("right", "half of the photos of a bottle mirrored", "B")
def mirrored_bottle(source, folder):
    return mirror_half(folder, *source.photos("bottle-stage-full"), 8)


@case("right", "a bottle on a turntable in a textured room that stands still, no masks", "B")
def still_room_b(source, folder):
    return as_they_are(folder, *source.photos("bottle-stage-full"))


@case("right", "a chair on a turntable in a textured room that stands still, no masks", "B")
def still_room_chair(source, folder):
    return as_they_are(folder, *source.photos("chair-stage-full"))


@case("right", "a spacecraft on a turntable before black: parts that repeat", "B")
def repeated_craft(source, folder):
    return as_they_are(folder, *source.photos("hubble-stand-full"))


@case("doubt", "a camera that turns about its own centre in another room: no depth can be known", "B")
def pure_rotation_b(source, folder):
    files, _, _ = source.photos("chair-orbit-full")
    return images_of.rotate_about_centre(folder, files[4], 24)


@case("doubt", "one photo of a chair twenty times, with noise", "B")
def nothing_moves_b(source, folder):
    files, _, _ = source.photos("chair-orbit-full")
    return noisy_copies(folder, files[7])


def make(name, source):
    """The folder of a case, made where it is missing."""
    folder = os.path.join(source.cache, "wrong", f"{name}-{captures.REVISION}")
    if os.path.isdir(folder):
        return folder
    part = folder + ".part"
    shutil.rmtree(part, ignore_errors=True)
    os.makedirs(os.path.join(part, "images"))
    function, asked, why, half = CASES[name]
    truths = function(source, part)
    if not os.listdir(os.path.join(part, "images")):
        os.rmdir(os.path.join(part, "images"))
    for which, (camera, poses) in truths.items():
        names = sorted(poses)
        truth.write_model(os.path.join(part, "truths", which), camera, [n + ".jpg" for n in names], [poses[n] for n in names])
    with open(os.path.join(part, "case.json"), "w") as file:
        json.dump({"name": name, "asked": asked, "why": why, "half": half}, file, indent=1)
    os.rename(part, folder)
    return folder


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("shared")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--cache", default=suite.cache_folder())
    args = parser.parse_args()
    if args.list:
        print("\n".join(f"{n:18} {asked:6} {why}" for n, (_, asked, why, _) in CASES.items()))
        return 0
    suite.install_three(args.cache)
    source, failed = Source(args.cache, os.path.abspath(args.shared)), 0
    for name in args.names or CASES:
        try:
            print(make(name, source), flush=True)
        except (RuntimeError, FileNotFoundError, subprocess.CalledProcessError) as error:
            print(f"{name}: {error}", file=sys.stderr, flush=True)
            failed += 1
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
