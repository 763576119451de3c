"""The places: a lit room, a dark room with clutter, a green screen. The yaw axis is x = y = 0.

Each light belongs to one of two groups, `lamp` (the lamp pointed at the satellite) or `room`
(everything else). Light adds up, so `develop.py` mixes the two as each case asks.
"""

import math
import random

import bpy
from mathutils import Vector

import materials as m
import shapes as s


def _aim(thing, at, target):
    thing.location = at
    thing.rotation_euler = (Vector(target) - Vector(at)).to_track_quat("-Z", "Y").to_euler()


def _light(kind, group, watts, at, target, size, colour=(1, 1, 1), **settings):
    data = bpy.data.lights.new(group, kind)
    data.energy, data.color = watts, colour
    setattr(data, "size" if kind == "AREA" else "shadow_soft_size", size)
    for key, value in settings.items():
        setattr(data, key, value)
    thing = bpy.data.objects.new(group, data)
    bpy.context.scene.collection.objects.link(thing)
    _aim(thing, at, target)
    thing.lightgroup = group
    thing.visible_camera = False
    return thing


def _lamp_with_stand(at, watts, cone_deg):
    """A spot light in a black housing on a stand, pointed at the satellite."""
    _light("SPOT", "lamp", watts, at, (0, 0, 0), 0.03, (1.0, 0.93, 0.82),
           spot_size=math.radians(cone_deg), spot_blend=0.6)
    black = m.plain("lamp housing", (0.03, 0.03, 0.03), 0.5)
    can = s.lathe("lamp housing", [(0.06, 0.16), (0.075, 0.05), (0.09, -0.02)], (0, 0, 0), black)
    _aim(can, at, (0, 0, 0))
    behind = Vector(at) * 1.06
    s.rod("lamp stand", (behind.x, behind.y, -1.2), tuple(behind), 0.014, black)


def _pole(bottom, material):
    """The pole that holds the mock-up; it does not turn. Its objects are returned."""
    return [
        s.rod("pole", (0, 0, bottom), (0, 0, -0.178), 0.013, material, sides=24),
        s.lathe("pole foot", [(1e-4, bottom + 0.04), (0.05, bottom + 0.035), (0.20, bottom + 0.01), (0.20, bottom)],
                (0, 0, 0), material),
    ]


def _world(rgb):
    world = bpy.context.scene.world or bpy.data.worlds.new("World")
    bpy.context.scene.world = world
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (*rgb, 1)
    world.lightgroup = "room"


def lit_room(_shot):
    """A room in daylight with a table; every surface has texture. Made for the demonstration."""
    floor = m.mottled("carpet", (0.10, 0.07, 0.06), (0.40, 0.30, 0.24), 9)
    wall = m.mottled("wall", (0.34, 0.34, 0.31), (0.66, 0.64, 0.58), 3.5)
    wood = m.mottled("wood", (0.16, 0.08, 0.035), (0.50, 0.31, 0.16), 9, 0.5, 4.0, (1.0, 9.0, 1.0))
    s.sheet("floor", 7, 7, floor, at=(0, 0, -1.0))
    for k in range(4):
        a = math.pi / 2 * k
        s.sheet("wall", 7, 4, wall, at=(2.6 * math.sin(a), -2.6 * math.cos(a), 0.6), turn_deg=(90, 0, 180 + 90 * k))
    s.lathe("table", [(1e-4, -0.34), (0.62, -0.34), (0.63, -0.36), (0.62, -0.38), (1e-4, -0.38)], (0, 0, 0), wood, sides=64)
    s.rod("table leg", (0, 0, -1.0), (0, 0, -0.38), 0.05, wood, sides=20)
    rng = random.Random(4)
    for k in range(16):
        a = 2 * math.pi * (k + 0.3 * rng.random()) / 16
        rgb = [0.25 + 0.7 * rng.random() for _ in range(3)]
        poster = m.patches(f"poster {k}", rgb, scale=8 + 12 * rng.random())
        side = round(a / (math.pi / 2)) % 4
        along = 2.0 * math.tan(a - side * math.pi / 2)
        c, w = math.cos(side * math.pi / 2), math.sin(side * math.pi / 2)
        at = (2.59 * w + along * c, -2.59 * c + along * w, -0.25 + 0.9 * rng.random())
        s.sheet("poster", 0.5 + 0.4 * rng.random(), 0.4 + 0.4 * rng.random(), poster, at=at, turn_deg=(90, 0, 180 + 90 * side))
    for k in range(9):
        a = 2 * math.pi * k / 9 + 0.2 * rng.random()
        size = [0.05 + 0.07 * rng.random() for _ in range(3)]
        thing = m.patches(f"block {k}", [0.2 + 0.8 * rng.random() for _ in range(3)], scale=45)
        at = (0.5 * math.sin(a), 0.5 * math.cos(a), -0.34 + size[2] / 2)
        s.box("block", size, at, thing, turn_deg=(0, 0, 90 * rng.random()))
    pole = _pole(-0.34, m.plain("pole", (0.12, 0.12, 0.13), 0.4, 0.5))
    _world((0.35, 0.37, 0.42))
    _light("AREA", "lamp", 55, (1.2, -0.9, 2.2), (0, 0, -0.2), 1.2, (1.0, 0.95, 0.88))
    _light("AREA", "room", 45, (-1.4, 1.2, 2.3), (0, 0, -0.3), 1.4, (0.9, 0.95, 1.0))
    return pole


def dark_room(_shot):
    """A laboratory of low reflectance with clutter along its walls; one lamp, hardly any other
    light."""
    black = m.mottled("dark wall", (0.012, 0.012, 0.013), (0.045, 0.044, 0.042), 5)
    floor = m.mottled("dark floor", (0.015, 0.014, 0.013), (0.055, 0.05, 0.045), 14)
    s.sheet("floor", 9, 9, floor, at=(0, 0, -1.15))
    for k in range(4):
        a = math.pi / 2 * k
        s.sheet("wall", 9, 4.2, black, at=(4.2 * math.sin(a), -4.2 * math.cos(a), 0.7), turn_deg=(90, 0, 180 + 90 * k))
    rng = random.Random(11)
    card = m.mottled("card", (0.05, 0.035, 0.02), (0.11, 0.08, 0.05), 12)
    metal = m.plain("cabinet", (0.06, 0.065, 0.07), 0.4, 0.3)
    for k in range(34):
        a = 2 * math.pi * (k + 0.6 * rng.random()) / 34
        radius = 3.2 + 0.7 * rng.random()
        size = (0.2 + 0.5 * rng.random(), 0.2 + 0.3 * rng.random(), 0.3 + 1.2 * rng.random() ** 2)
        kind = rng.choice((card, metal, m.patches(f"crate {k}", [0.04 + 0.12 * rng.random() for _ in range(3)], scale=12)))
        at = (radius * math.sin(a), radius * math.cos(a), -1.15 + size[2] / 2)
        s.box("clutter", size, at, kind, turn_deg=(0, 0, 360 * rng.random()))
        if k % 4 == 0:
            s.rod("pipe", (at[0] * 0.95, at[1] * 0.95, -1.15), (at[0] * 0.97, at[1], 1.2), 0.02, metal)
    pole = _pole(-1.15, m.plain("pole", (0.05, 0.05, 0.055), 0.4, 0.5))
    _world((0.004, 0.0042, 0.005))
    _lamp_with_stand((1.9, -2.3, 1.5), 480, 40)
    _light("AREA", "room", 1.6, (0, 0, 2.6), (0, 0, 0), 2.0)
    return pole


def _cloth(x, y):
    """Folds of the screen's cloth, metres."""
    return 0.010 * math.sin(7 * x + 2 * y) + 0.006 * math.sin(17 * x - 3 * y + 1) + 0.02 * math.sin(2.3 * y + x)


def _shelves(dark, wood):
    for k, at in enumerate(((1.52, 1.45, -0.55), (1.60, 1.45, 0.15), (-1.60, 1.5, -0.7), (-1.55, 1.5, 0.45))):
        s.box("shelf", (0.36, 0.3, 0.5), at, wood if k % 2 else dark, turn_deg=(0, 0, 7 * k))
        s.box("label", (0.18, 0.01, 0.12), (at[0], at[1] - 0.16, at[2]), m.patches(f"label {k}", (0.7, 0.6, 0.4), scale=40))


def _furniture(rng, green, seam, materials):
    """Another cloth, and things beside it: cabinets stand upright, posters hang by eye, boards
    lean, stands have three legs and a column."""
    width, turn, hang = rng.uniform(1.7, 2.4), rng.uniform(-5, 5), rng.gauss(0, 0.5)
    middle = rng.uniform(-0.1, 0.1)
    s.sheet("screen", width, 2.3, green, at=(middle, 1.25, 0.10), turn_deg=(90, hang, turn), wave=_cloth, steps=90)
    s.rod("screen bar", (middle - width / 2, 1.3, 1.27), (middle + width / 2, 1.3, 1.27), 0.02, materials[0])
    if rng.random() < 0.5:
        x = rng.choice((-1, 1)) * rng.uniform(0.35, 0.7)
        s.sheet("seam", 0.012, 2.3, seam, at=(x, 1.185, 0.10), turn_deg=(90, hang, turn))
    for k in range(rng.randint(6, 9)):
        side = 1 if k % 2 else -1
        x = middle + side * (width / 2 + rng.uniform(0.0, 0.45))
        material = rng.choice((*materials, m.patches(f"thing {k}", [0.1 + 0.6 * rng.random() for _ in range(3)], scale=12)))
        kind = rng.choice(("cabinet", "cabinet", "poster", "board", "stand"))
        if kind == "cabinet":
            size = (rng.uniform(0.15, 0.5), rng.uniform(0.15, 0.4), rng.uniform(0.3, 1.4))
            s.box(kind, size, (x + side * size[0] / 2, rng.uniform(0.9, 1.5), -1.05 + size[2] / 2), material, turn_deg=(0, 0, rng.uniform(0, 90)))
        elif kind == "poster":
            size = (rng.uniform(0.2, 0.4), rng.uniform(0.2, 0.5))
            at = (x + side * 0.25, 1.745, rng.uniform(-0.5, 0.7))
            s.sheet(kind, *size, material, at=at, turn_deg=(90, rng.gauss(0, 1.0), 0))
        elif kind == "board":
            lean = rng.uniform(4, 12)
            s.box(kind, (rng.uniform(0.2, 0.5), 0.03, 1.1), (x + side * 0.2, 1.45, -0.5), material,
                  turn_deg=(-lean, rng.gauss(0, 1.5), rng.gauss(0, 8)))
        else:
            top = rng.uniform(0.2, 1.2)
            s.rod(kind, (x, 1.0, -0.6), (x, 1.0, top), 0.018, materials[0])
            for leg in range(3):
                a = 2 * math.pi * leg / 3 + rng.random()
                s.rod("leg", (x, 1.0, -0.5), (x + 0.3 * math.cos(a), 1.0 + 0.3 * math.sin(a), -1.05), 0.012, materials[0])


def green_screen(_shot, seed=None):
    """A green cloth with folds and a seam before a grey wall; it does not fill the picture. With a
    seed the cloth hangs otherwise and other things stand and hang beside it (`furniture`)."""
    green = m.mottled("green cloth", (0.030, 0.30, 0.062), (0.040, 0.38, 0.080), 3, 0.9)
    seam = m.plain("seam", (0.022, 0.22, 0.045), 0.9)
    wall = m.mottled("grey wall", (0.22, 0.21, 0.20), (0.36, 0.35, 0.33), 4)
    floor = m.mottled("laboratory floor", (0.09, 0.09, 0.095), (0.24, 0.235, 0.23), 22, 0.6)
    dark = m.plain("dark things", (0.05, 0.05, 0.06), 0.5)
    wood = m.mottled("shelf", (0.14, 0.08, 0.04), (0.36, 0.22, 0.12), 8, 0.6, 4.0, (1, 8, 1))
    if seed is None:
        s.sheet("screen", 2.46, 2.3, green, at=(-0.06, 1.25, 0.10), turn_deg=(90, 0, -2), wave=_cloth, steps=90)
        s.sheet("seam", 0.012, 2.3, seam, at=(0.62, 1.185, 0.10), turn_deg=(90, 0, -2))
        s.rod("screen bar", (-1.45, 1.3, 1.27), (1.4, 1.3, 1.27), 0.02, dark)
        _shelves(dark, wood)
    else:
        _furniture(random.Random(seed), green, seam, (dark, wood))
    s.sheet("wall", 8, 4, wall, at=(0, 1.75, 0.6), turn_deg=(90, 0, 0))
    s.sheet("wall behind", 8, 4, wall, at=(0, -3.6, 0.6), turn_deg=(90, 0, 180))
    for side in (-1, 1):
        s.sheet("side wall", 6, 4, wall, at=(3.4 * side, -0.9, 0.6), turn_deg=(90, 0, 90 * side))
    s.sheet("floor", 9, 9, floor, at=(0, 0, -1.05))
    s.sheet("ceiling", 9, 9, wall, at=(0, 0, 2.4), turn_deg=(180, 0, 0))
    pole = _pole(-1.05, m.plain("pole", (0.10, 0.10, 0.11), 0.45, 0.4))
    _world((0.05, 0.05, 0.055))
    _lamp_with_stand((-1.15, -1.75, 0.95), 620, 46)
    _light("AREA", "room", 30, (-1.0, 0.2, 2.0), (-0.3, 1.25, 0.2), 0.7, (1.0, 0.98, 0.94))
    _light("AREA", "room", 12, (1.3, 0.0, 2.1), (0.7, 1.25, 0.0), 0.7, (0.95, 0.98, 1.0))
    return pole
