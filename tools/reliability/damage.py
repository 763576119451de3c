"""What is done to good models and data sets, and what must be harmless.

Each function takes a model (colmap.py) and a random.Random, and changes the model in place.
WRONG are mistakes and damages that files have; HARMLESS what the program must take as it is.
"""
import math

import numpy as np

from colmap import rotation

NONSENSE = [math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-300]
WRONG, HARMLESS = {}, {}


def wrong(function):
    WRONG[function.__name__] = function
    return function


def harmless(function):
    HARMLESS[function.__name__] = function
    return function


def some(values, rng, most=1.0):
    """A few of the values, or all."""
    values = list(values)
    return rng.sample(values, rng.randint(1, max(1, int(most * len(values)))))


def from_matrix(R):
    """Quaternion w x y z of a rotation matrix (eigenvector form, Bar-Itzhack 2000)."""
    K = np.array([[R[0, 0] - R[1, 1] - R[2, 2], 0, 0, 0],
                  [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0, 0],
                  [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0],
                  [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], np.trace(R)]])
    x, y, z, w = np.linalg.eigh(K / 3)[1][:, -1]
    return [float(v) for v in (w, x, y, z)]


def turned(image, rng, degrees):
    """The image's rotation followed by one about a random axis."""
    axis = np.array([rng.gauss(0, 1) for _ in range(3)])
    x, y, z = axis / np.linalg.norm(axis)
    a = math.radians(degrees)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    image["q"] = from_matrix((np.eye(3) + math.sin(a) * K + (1 - math.cos(a)) * K @ K) @ rotation(image["q"]))


@wrong
def quaternion_of_no_rotation(model, rng):
    factor = rng.choice([0.0, 1e-6, 10.0, 1e6, *NONSENSE])
    for image in some(model["images"].values(), rng):
        image["q"] = [v * factor for v in image["q"]]


@wrong
def number_of_a_pose_is_nonsense(model, rng):
    image = rng.choice(list(model["images"].values()))
    rng.choice([image["q"], image["t"]])[rng.randrange(3)] = rng.choice(NONSENSE)


@wrong
def poses_are_equal(model, rng):
    source = rng.choice(list(model["images"].values()))
    for image in some(model["images"].values(), rng):
        image["q"], image["t"] = list(source["q"]), list(source["t"])
    other = rng.choice([i for i in model["images"].values() if i is not source])
    other["q"], other["t"] = list(source["q"]), list(source["t"])


@wrong
def poses_are_exchanged(model, rng):
    a, b = rng.sample(list(model["images"].values()), 2)
    a["q"], a["t"], b["q"], b["t"] = b["q"], b["t"], a["q"], a["t"]


@wrong
def poses_are_shifted_by_one(model, rng):
    images = list(model["images"].values())
    poses = [(i["q"], i["t"]) for i in images]
    for image, (q, t) in zip(images, poses[1:] + poses[:1]):
        image["q"], image["t"] = q, t


@wrong
def rotation_is_off(model, rng):
    for image in some(model["images"].values(), rng):
        turned(image, rng, rng.choice([5, 20, 90, 180]))


@wrong
def position_is_off(model, rng):
    for image in some(model["images"].values(), rng, 0.5):
        image["t"] = [v + rng.choice([0.3, 1, 10, 1e6, 1e12]) * rng.gauss(0, 1) for v in image["t"]]


@wrong
def pose_is_the_inverse(model, rng):
    for image in some(model["images"].values(), rng):
        R, t = rotation(image["q"]), np.array(image["t"])
        image["q"], image["t"] = from_matrix(R.T), [float(v) for v in -R.T @ t]


@wrong
def quaternion_order_is_another(model, rng):
    for image in model["images"].values():
        image["q"] = image["q"][1:] + image["q"][:1]


@wrong
def axes_are_another_convention(model, rng):
    signs = rng.choice([(1, -1, -1), (-1, -1, 1), (-1, 1, -1)])
    for image in model["images"].values():
        image["q"] = from_matrix(np.diag(signs) @ rotation(image["q"]))


@wrong
def world_is_mirrored(model, rng):
    for point in model["points"].values():
        point["x"][0] = -point["x"][0]
    if not model["points"]:
        poses_are_shifted_by_one(model, rng)


@wrong
def image_size_is_another(model, rng):
    camera = rng.choice(list(model["cameras"].values()))
    which = rng.choice([[1], [2], [1, 2]])
    factor = rng.choice([0, 0.5, 2, 10, 1e6]) if len(which) == 1 else rng.choice([0, 10])
    for k in which:
        camera[k] = int(camera[k] * factor)
    if len(which) == 2 and factor:
        camera[3] = [v * rng.choice([1, 3]) for v in camera[3]]


@wrong
def focal_length_is_another(model, rng):
    camera = rng.choice(list(model["cameras"].values()))
    camera[3][0] = rng.choice([-1, 0, 1e-6, 0.3, 0.6, 1.7, 3, 1e6, *NONSENSE]) * camera[3][0]


@wrong
def principal_point_is_another(model, rng):
    camera = rng.choice(list(model["cameras"].values()))
    camera[3][rng.choice([1, 2])] += rng.choice([-1, 1]) * rng.choice([0.3, 1, 100, 1e9, math.nan]) * camera[1]


@wrong
def distortion_is_huge(model, rng):
    camera = rng.choice(list(model["cameras"].values()))
    camera[3][3] = rng.choice([-2, 3, -100, 1e9, math.nan])


@wrong
def camera_has_too_few_parameters(model, rng):
    camera = rng.choice(list(model["cameras"].values()))
    camera[3] = camera[3][: rng.randint(0, 3)]


@wrong
def camera_model_is_another(model, rng):
    rng.choice(list(model["cameras"].values()))[0] = rng.choice(["PINHOLE", "OPENCV", "RADIAL", "NONE", ""])


@wrong
def camera_is_missing(model, rng):
    rng.choice(list(model["images"].values()))["camera"] = rng.choice([0, 7, 4294967295])


@wrong
def names_are_repeated(model, rng):
    a, b = rng.sample(list(model["images"].values()), 2)
    a["name"] = b["name"]


@wrong
def names_are_exchanged(model, rng):
    a, b = rng.sample(list(model["images"].values()), 2)
    a["name"], b["name"] = b["name"], a["name"]


@wrong
def names_are_shifted_by_one(model, rng):
    images = list(model["images"].values())
    names = [i["name"] for i in images]
    for image, name in zip(images, names[1:] + names[:1]):
        image["name"] = name


@wrong
def name_leads_elsewhere(model, rng):
    names = ["../001.png", "/etc/passwd", "", ".", "no.png", "a\\..\\b.png", "001.png/..", "x" * 300, "\u202e001.png"]
    rng.choice(list(model["images"].values()))["name"] = rng.choice(names)


@wrong
def image_is_left_out(model, rng):
    del model["images"][rng.choice(list(model["images"]))]


@wrong
def images_are_left_out_whole(model, rng):
    gone = set(some(model["images"], rng, 0.8))
    model["images"] = {n: i for n, i in model["images"].items() if n not in gone}
    for point in model["points"].values():
        point["track"] = [t for t in point["track"] if t[0] not in gone]
    model["points"] = {n: p for n, p in model["points"].items() if len(p["track"]) > 1}
    for image in model["images"].values():
        image["seen"] = [s if s[2] in model["points"] else [s[0], s[1], -1] for s in image["seen"]]


@wrong
def points_lie_elsewhere(model, rng):
    for point in some(model["points"].values(), rng, rng.choice([0.05, 0.3, 1])):
        point["x"] = [v + rng.choice([1, 10]) * rng.gauss(0, 1) for v in point["x"]]


@wrong
def points_have_another_scale(model, rng):
    factor = rng.choice([0.5, 2, 1e-6, 1e6, 1e30])
    for point in model["points"].values():
        point["x"] = [v * factor for v in point["x"]]


@wrong
def a_point_is_nonsense(model, rng):
    rng.choice(list(model["points"].values()))["x"][rng.randrange(3)] = rng.choice(NONSENSE)


@wrong
def points_are_exchanged(model, rng):
    numbers = some(model["points"], rng, 1)
    places = [model["points"][n]["x"] for n in numbers]
    rng.shuffle(places)
    for number, place in zip(numbers, places):
        model["points"][number]["x"] = place


@wrong
def tracks_name_images_that_are_not_there(model, rng):
    for point in some(model["points"].values(), rng, 0.2):
        rng.choice(point["track"])[0] = rng.choice([0, 999, 4294967295])


@wrong
def tracks_name_keypoints_that_are_not_there(model, rng):
    for point in some(model["points"].values(), rng, 0.2):
        rng.choice(point["track"])[1] = rng.choice([99999, 4294967295])


@wrong
def tracks_name_other_keypoints(model, rng):
    for point in some(model["points"].values(), rng, 0.5):
        element = rng.choice(point["track"])
        element[1] = rng.randrange(len(model["images"][element[0]]["seen"]))


@wrong
def keypoints_lie_elsewhere(model, rng):
    for image in some(model["images"].values(), rng):
        apart = [rng.choice([-60, 60]), rng.choice([-60, 60])]
        image["seen"] = [[x + apart[0], y + apart[1], p] for x, y, p in image["seen"]]


@wrong
def keypoints_are_nonsense(model, rng):
    for image in some(model["images"].values(), rng):
        rng.choice([s for s in image["seen"] if s[2] >= 0])[rng.randrange(2)] = rng.choice(NONSENSE)


@wrong
def keypoints_are_exchanged(model, rng):
    for image in some(model["images"].values(), rng):
        places = [s[:2] for s in image["seen"]]
        rng.shuffle(places)
        image["seen"] = [[*place, s[2]] for place, s in zip(places, image["seen"])]


@harmless
def nothing(model, rng):
    pass


@harmless
def keypoints_have_noise(model, rng):
    for image in model["images"].values():
        image["seen"] = [[x + rng.gauss(0, 0.5), y + rng.gauss(0, 0.5), p] for x, y, p in image["seen"]]


@harmless
def quaternions_have_another_sign_and_few_digits(model, rng):
    for image in model["images"].values():
        sign = rng.choice([-1, 1])
        image["q"] = [round(sign * v, 5) for v in image["q"]]


@harmless
def world_is_another(model, rng):
    scale = rng.choice([1e-3, 1e3])
    for image in model["images"].values():
        image["t"] = [v * scale for v in image["t"]]
    for point in model["points"].values():
        point["x"] = [v * scale for v in point["x"]]


@harmless
def each_image_has_a_camera_of_its_own(model, rng):
    camera = next(iter(model["cameras"].values()))
    model["cameras"] = {n: [camera[0], camera[1], camera[2], list(camera[3])] for n in model["images"]}
    for number, image in model["images"].items():
        image["camera"] = number


@harmless
def order_is_another(model, rng):
    for what in ("images", "points"):
        entries = list(model[what].items())
        rng.shuffle(entries)
        model[what] = dict(entries)
