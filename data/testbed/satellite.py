"""The satellite mock-up: foil body, two solar arrays that look alike, dish, nozzles, rods, labels.

About 1.1 m from tip to tip. Rods are 6 mm thick: 2 pixels at 1.524 m and f = 520 px.
"""

import math
import random

import bpy
from mathutils import Euler

import cases
import materials as m
import shapes as s

BODY = (0.30, 0.26, 0.34)  # metres


def mounted():
    """An empty `Satellite`, which stands on the yaw axis, and what its parts are fixed to, a little
    off it."""
    root = bpy.data.objects.new("Satellite", None)
    mount = bpy.data.objects.new("Mount", None)
    for thing in (root, mount):
        bpy.context.scene.collection.objects.link(thing)
    mount.parent = root
    s.place(mount, cases.MOUNT_M, cases.MOUNT_DEG)
    return root, mount


def build():
    """The mock-up under an empty `Satellite`, which stands on the yaw axis."""
    root, mount = mounted()
    _body(mount)
    for side in (-1, 1):
        _array(mount, side)
    _dish(mount)
    _nozzles(mount)
    _rods(mount)
    _labels(mount)
    return root


def _body(parent):
    gold = m.foil("gold foil", (1.0, 0.68, 0.24))
    silver = m.foil("silver foil", (0.86, 0.86, 0.88), cell=30.0)
    grey = m.plain("radiator paint", (0.62, 0.62, 0.60), 0.45)
    frame = m.plain("anodised frame", (0.05, 0.05, 0.055), 0.4, 0.4)
    x, y, z = BODY
    s.box("body", BODY, (0, 0, 0), gold, parent)
    s.box("radiator", (0.20, 0.008, 0.24), (0, -y / 2 - 0.004, 0.015), grey, parent)
    s.box("radiator b", (0.008, 0.15, 0.16), (x / 2 + 0.004, 0.0, -0.06), silver, parent)
    s.box("equipment", (0.12, 0.09, 0.05), (-0.05, 0.05, z / 2 + 0.025), silver, parent, (0, 0, 12))
    s.box("lid", (0.09, 0.09, 0.03), (0.08, -0.05, z / 2 + 0.015), grey, parent, (0, 0, -20))
    for i in (-1, 1):
        for j in (-1, 1):
            s.box("edge", (0.014, 0.014, z + 0.01), (i * x / 2, j * y / 2, 0), frame, parent)
            s.box("rim", (x, 0.012, 0.012), (0, i * y / 2, j * z / 2), frame, parent)


def _array(parent, side):
    """A solar array on a yoke, turned about its boom by 35 degrees. Both look alike."""
    cells = bpy.data.materials.get("solar cells") or m.solar_cells("solar cells")
    back = bpy.data.materials.get("array back") or m.mottled("array back", (0.10, 0.09, 0.08), (0.22, 0.20, 0.17), 30)
    boom = bpy.data.materials.get("boom") or m.plain("boom", (0.55, 0.55, 0.56), 0.35, 0.8)
    x0, reach = BODY[0] / 2, 0.07
    s.rod("boom", (side * x0, 0, 0.03), (side * (x0 + reach), 0, 0.03), 0.009, boom, parent, 12)
    hinge = bpy.data.objects.new("hinge", None)
    bpy.context.scene.collection.objects.link(hinge)
    hinge.parent = parent
    hinge.location = (side * (x0 + reach), 0, 0.03)
    hinge.rotation_euler = Euler((math.radians(55), 0, 0))
    for panel in range(2):
        middle = side * (0.084 + panel * 0.176)
        s.box("panel", (0.168, 0.24, 0.008), (middle, 0, 0), back, hinge)
        s.sheet("cells", 0.160, 0.232, cells, hinge, (middle, 0, 0.0045))
    s.rod("yoke", (0, -0.1, 0), (0, 0.1, 0), 0.005, boom, hinge)


def _dish(parent):
    white = m.plain("dish white", (0.78, 0.78, 0.75), 0.5)
    dark = m.plain("feed", (0.08, 0.08, 0.09), 0.4)
    strut = m.plain("strut", (0.5, 0.5, 0.5), 0.4, 0.6)
    tilt, at = (-78, 0, 14), (0.02, BODY[1] / 2 + 0.035, 0.05)
    radius, depth = 0.105, 0.036
    inside = [(radius * k / 10 + 1e-4, depth * (k / 10) ** 2) for k in range(11)]
    shell = inside + [(radius, depth - 0.004)] + [(r, z - 0.004) for r, z in inside[-2::-1]]
    dish = s.lathe("dish", shell, at, white, parent, tilt, 48)
    for k in range(3):
        a = 2 * math.pi * k / 3
        s.rod("strut", (0.95 * radius * math.cos(a), 0.95 * radius * math.sin(a), depth), (0, 0, 0.105), 0.003, strut, dish, 8)
    s.lathe("horn", [(0.004, 0.085), (0.016, 0.09), (0.010, 0.115), (1e-4, 0.118)], (0, 0, 0), dark, dish)
    s.rod("dish mount", (0, 0, -0.045), (0, 0, 0.0), 0.014, strut, dish, 12)


def _nozzles(parent):
    metal = m.plain("nozzle", (0.30, 0.27, 0.25), 0.3, 1.0)
    z = BODY[2]
    bell = [(0.010, 0), (0.012, 0.012), (0.022, 0.035), (0.028, 0.058), (0.026, 0.058), (0.011, 0.014), (1e-4, 0.010)]
    for i in (-1, 1):
        for j in (-1, 1):
            s.lathe("thruster", bell, (i * 0.10, j * 0.085, -z / 2), metal, parent, (180 + 18 * j, -18 * i, 0), 28)
    big = [(1.5 * r, 1.5 * h) for r, h in bell]
    s.lathe("main engine", big, (-BODY[0] / 2 + 0.002, -0.03, -0.09), metal, parent, (0, -90, 0), 32)


def _rods(parent):
    steel = m.plain("steel", (0.6, 0.6, 0.62), 0.3, 0.9)
    black = m.plain("whip", (0.03, 0.03, 0.03), 0.5)
    top = BODY[2] / 2
    s.rod("whip a", (0.13, 0.10, top), (0.20, 0.17, top + 0.22), 0.003, steel, parent)
    s.rod("whip b", (-0.13, 0.10, top), (-0.21, 0.16, top + 0.20), 0.003, black, parent)
    s.rod("mast", (-0.12, -0.10, top), (-0.12, -0.10, top + 0.17), 0.003, steel, parent)
    s.box("magnetometer", (0.03, 0.03, 0.04), (-0.12, -0.10, top + 0.185), black, parent)
    s.rod("brace", (0.15, -0.12, -0.12), (0.23, -0.17, -0.24), 0.003, steel, parent)
    s.lathe("tracker", [(1e-4, 0), (0.024, 0), (0.024, 0.05), (0.03, 0.09), (0.027, 0.09), (0.02, 0.05), (1e-4, 0.045)],
            (0.09, 0.07, top), black, parent, (25, 20, 0), 28)


def _labels(parent):
    ink = m.plain("ink", (0.02, 0.02, 0.03), 0.6)
    red = m.plain("red", (0.55, 0.03, 0.03), 0.5)
    paper = m.plain("paper", (0.75, 0.75, 0.72), 0.7)
    blue = m.plain("blue", (0.03, 0.10, 0.45), 0.5)
    x, y, _ = BODY
    front = -y / 2 - 0.009
    s.text("name", "SAT-RECON", 0.036, ink, parent, (0, front, 0.10), (90, 0, 0))
    s.text("number", "TB-03  A7", 0.026, red, parent, (-0.02, front, 0.062), (90, 0, 0))
    s.text("warning", "HANDLE BY FRAME ONLY", 0.0145, ink, parent, (0, front, 0.035), (90, 0, 0))
    _code(parent, (-0.05, front, -0.04), (90, 0, 0), ink, 5)
    s.sheet("flag", 0.07, 0.045, blue, parent, (0.05, front, -0.03), (90, 0, 0))
    s.sheet("flag stripe", 0.07, 0.013, paper, parent, (0.05, front - 0.001, -0.03), (90, 0, 0))
    for sign, words, seed in ((-1, "PORT 2", 8), (1, "STBD 1", 9)):
        at = sign * (x / 2 + 0.010)
        s.sheet("plate", 0.10, 0.055, paper, parent, (at - sign * 0.001, 0.05, 0.125), (90, 0, 90 * sign))
        s.text("side", words, 0.024, red, parent, (at, 0.05, 0.125), (90, 0, 90 * sign))
        _code(parent, (at, 0.04, 0.02 if sign < 0 else -0.05), (90, 0, 90 * sign), ink, seed, paper)
    s.sheet("plate", 0.12, 0.05, paper, parent, (-0.06, y / 2 + 0.001, -0.12), (90, 0, 180))
    s.text("back", "REMOVE COVER", 0.014, ink, parent, (-0.06, y / 2 + 0.002, -0.12), (90, 0, 180))
    s.text("top", "N-15", 0.03, ink, parent, (0.08, -0.05, BODY[2] / 2 + 0.031), (0, 0, -20))


def _code(parent, at, turn_deg, ink, seed, ground=None):
    """A square of random modules, as on a two-dimensional bar code."""
    rng = random.Random(seed)
    holder = bpy.data.objects.new("code", None)
    bpy.context.scene.collection.objects.link(holder)
    holder.parent = parent
    s.place(holder, at, turn_deg)
    pitch, n = 0.0085, 8
    if ground is not None:
        s.sheet("code ground", (n + 1) * pitch, (n + 1) * pitch, ground, holder, (0, 0, -0.0005))
    for i in range(n):
        for j in range(n):
            if rng.random() < 0.5:
                s.sheet("module", pitch, pitch, ink, holder, ((i - n / 2 + 0.5) * pitch, (j - n / 2 + 0.5) * pitch, 0.0004))
