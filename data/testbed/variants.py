"""Other satellites than the mock-up, drawn at random: what the key's outline is learnt from
(tools/train_outline.sh).

Bodies of boxes and drums in foil or paint, arrays of panels with slits, dishes, nozzles, rods,
lattices. About as large as the mock-up. From seed TRIMMED on edges are of another material than
faces, and more is white.
"""

import math
import random

import bpy

import materials as m
import satellite
import shapes as s

TRIMMED = 100  # first seed of those with rails, plates and frames


def build(seed):
    """One satellite under an empty `Satellite`, which stands on the yaw axis."""
    rng = random.Random(seed)
    trimmed = seed >= TRIMMED
    root, mount = satellite.mounted()
    size = [rng.uniform(0.16, 0.40) for _ in range(3)]
    _body(rng, mount, size)
    if trimmed:
        _trim(rng, mount, size)
        _plates(rng, mount, size)
    for side in rng.choice([(-1, 1), (-1, 1), (1,), (-1,)]):
        _array(rng, mount, side, size, trimmed)
    for _ in range(rng.randint(0, 2)):
        _dish(rng, mount, size, trimmed)
    for _ in range(rng.randint(0, 4)):
        _nozzle(rng, mount, size)
    for _ in range(rng.randint(2, 7)):
        _rod(rng, mount, size, trimmed)
    for _ in range(rng.randint(0, 2)):
        _lattice(rng, mount, size)
    return root


def _any_material(rng):
    """Foil, paint, metal, mottled card or cells, of any colour."""
    name = f"m{rng.random()}"
    light, tint = math.exp(rng.uniform(math.log(0.02), math.log(0.85))), rng.choice([0.0, 0.1, 0.5])
    rgb = tuple(light * (1 - tint * rng.random()) for _ in range(3))
    kind = rng.random()
    if kind < 0.35:
        rgb = rng.choice([(1.0, 0.68, 0.24), (0.86, 0.86, 0.88), (0.9, 0.5, 0.3), (0.25, 0.22, 0.2)])
        return m.foil(name, rgb, rng.uniform(15, 60))
    if kind < 0.7:
        return m.plain(name, rgb, rng.uniform(0.25, 0.8), rng.choice([0.0, 0.0, 0.8]))
    if kind < 0.85:
        return m.mottled(name, tuple(0.4 * v for v in rgb), rgb, rng.uniform(10, 50))
    return m.solar_cells(name)


def _somewhere(rng, size):
    """A point on the body's surface and the axis and side of the face."""
    axis, side = rng.randrange(3), rng.choice([-1, 1])
    at = [rng.uniform(-0.42, 0.42) * v for v in size]
    at[axis] = side * size[axis] / 2
    return at, axis, side


def _body(rng, parent, size):
    s.box("body", size, (0, 0, 0), _any_material(rng), parent)
    for _ in range(rng.randint(1, 6)):
        at, _, _ = _somewhere(rng, size)
        box = [rng.uniform(0.03, 0.16) for _ in range(3)]
        s.box("box", box, at, _any_material(rng), parent, (0, 0, rng.uniform(-30, 30)))
    if rng.random() < 0.4:
        r, h = rng.uniform(0.05, 0.14), rng.uniform(0.04, 0.16)
        s.lathe("drum", [(r, 0), (r, h), (1e-4, h)], (0, 0, size[2] / 2), _any_material(rng), parent, (0, 0, 0), 32)


def _trim(rng, parent, size):
    """Rails along the edges of the body."""
    wide, paint = rng.uniform(0.004, 0.018), _edge_material(rng)
    for axis in range(3):
        for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            at, box = [0, 0, 0], [wide] * 3
            at[(axis + 1) % 3], at[(axis + 2) % 3] = a * size[(axis + 1) % 3] / 2, b * size[(axis + 2) % 3] / 2
            box[axis] = size[axis] + wide
            s.box("rail", box, at, paint, parent)


def _plates(rng, parent, size):
    """Labels and radiators on the faces."""
    for _ in range(rng.randint(0, 5)):
        at, axis, _ = _somewhere(rng, size)
        box = [rng.uniform(0.03, 0.6) * v for v in size]
        box[axis] = 0.006
        at = [min(max(v, (b - e) / 2), (e - b) / 2) if k != axis else v for k, (v, b, e) in enumerate(zip(at, box, size))]
        s.box("plate", box, at, _white(rng) if rng.random() < 0.6 else _any_material(rng), parent)


def _edge_material(rng):
    shade = rng.choice([0.02, 0.05, 0.1, 0.2, 0.5, 0.8])
    return m.plain(f"edge{rng.random()}", (shade,) * 3, rng.uniform(0.3, 0.7), rng.choice([0.0, 0.0, 0.9]))


def _white(rng):
    return m.plain(f"white{rng.random()}", (rng.uniform(0.7, 0.9),) * 3, rng.uniform(0.3, 0.8))


def _array(rng, parent, side, size, trimmed):
    cells = _any_material(rng) if rng.random() < 0.3 else m.solar_cells(f"cells{rng.random()}")
    back, boom = _any_material(rng), m.plain(f"boom{rng.random()}", (0.5, 0.5, 0.5), 0.35, 0.8)
    x0, reach, z = size[0] / 2, rng.uniform(0.02, 0.10), rng.uniform(-0.3, 0.3) * size[2]
    s.rod("boom", (side * x0, 0, z), (side * (x0 + reach), 0, z), rng.uniform(0.003, 0.01), boom, parent, 12)
    hinge = bpy.data.objects.new("hinge", None)
    bpy.context.scene.collection.objects.link(hinge)
    hinge.parent = parent
    s.place(hinge, (side * (x0 + reach), 0, z), (rng.uniform(0, 90), 0, rng.uniform(-12, 12)))
    width, height, slit = rng.uniform(0.07, 0.2), rng.uniform(0.12, 0.32), rng.uniform(0.003, 0.014)
    framed, wide, edge = (rng.random() < 0.6, rng.uniform(0.002, slit), _edge_material(rng)) if trimmed else (False, 0, None)
    for panel in range(rng.randint(1, 3)):
        middle = side * (width / 2 + panel * (width + slit))
        s.box("panel", (width, height, 0.008), (middle, 0, 0), back, hinge)
        s.sheet("cells", width - 0.008, height - 0.008, cells, hinge, (middle, 0, 0.0045))
        if framed:
            for k in (-1, 1):
                s.box("frame", (wide, height + wide, 0.011), (middle + k * width / 2, 0, 0), edge, hinge)
                s.box("frame", (width + wide, wide, 0.011), (middle, k * height / 2, 0), edge, hinge)
    s.rod("yoke", (0, -0.4 * height, 0), (0, 0.4 * height, 0), 0.005, boom, hinge)


def _dish(rng, parent, size, trimmed):
    at, axis, side = _somewhere(rng, size)
    at[axis] += side * 0.03
    radius = rng.uniform(0.05, 0.15)
    depth = radius * rng.uniform(0.2, 0.5)
    inside = [(radius * k / 10 + 1e-4, depth * (k / 10) ** 2) for k in range(11)]
    shell = inside + [(radius, depth - 0.004)] + [(r, z - 0.004) for r, z in inside[-2::-1]]
    turn = [rng.uniform(-110, 110), rng.uniform(-110, 110), 0]
    paint = _white(rng) if trimmed and rng.random() < 0.6 else _any_material(rng)
    dish = s.lathe("dish", shell, at, paint, parent, turn, 48)
    strut = m.plain(f"strut{rng.random()}", (0.5, 0.5, 0.5), 0.4, 0.6)
    for k in range(3):
        a = 2 * math.pi * k / 3
        edge = (0.95 * radius * math.cos(a), 0.95 * radius * math.sin(a), depth)
        s.rod("strut", edge, (0, 0, radius), rng.uniform(0.002, 0.004), strut, dish, 8)


def _nozzle(rng, parent, size):
    at, axis, side = _somewhere(rng, size)
    k = rng.uniform(0.8, 2.0)
    bell = [(0.010, 0), (0.012, 0.012), (0.022, 0.035), (0.028, 0.058), (0.026, 0.058), (0.011, 0.014), (1e-4, 0.010)]
    turn = {0: (0, 90 * side, 0), 1: (-90 * side, 0, 0), 2: (0 if side > 0 else 180, 0, 0)}[axis]
    metal = m.plain(f"nozzle{rng.random()}", (0.30, 0.27, 0.25), 0.3, 1.0)
    s.lathe("nozzle", [(k * r, k * z) for r, z in bell], at, metal, parent, turn, 28)


def _rod(rng, parent, size, trimmed):
    at, axis, side = _somewhere(rng, size)
    end = [v + rng.uniform(-0.1, 0.1) for v in at]
    end[axis] += side * rng.uniform(0.06, 0.24)
    shade = rng.choice([0.03, 0.1, 0.3, 0.6, 0.9] if trimmed else [0.03, 0.1, 0.3, 0.6])
    paint = m.plain(f"rod{rng.random()}", (shade,) * 3, 0.4, rng.choice([0.0, 0.9]))
    s.rod("rod", at, end, rng.uniform(0.002, 0.008), paint, parent)
    if rng.random() < 0.4:
        s.box("tip", [rng.uniform(0.015, 0.05) for _ in range(3)], end, _any_material(rng), parent)


def _lattice(rng, parent, size):
    """A boom of three spars with diagonals."""
    at, axis, side = _somewhere(rng, size)
    pitch, reach, radius = rng.uniform(0.03, 0.06), rng.uniform(0.015, 0.04), rng.uniform(0.0015, 0.003)
    paint = m.plain(f"lattice{rng.random()}", (rng.choice([0.05, 0.4, 0.7]),) * 3, 0.5)
    spars = [(reach * math.cos(2.1 * k), reach * math.sin(2.1 * k)) for k in range(3)]

    def point(k, along):
        p = list(at)
        p[axis] += side * along * pitch
        p[(axis + 1) % 3] += spars[k][0]
        p[(axis + 2) % 3] += spars[k][1]
        return p

    for bay in range(rng.randint(3, 6)):
        for k in range(3):
            s.rod("spar", point(k, bay), point(k, bay + 1), radius, paint, parent, 6)
            s.rod("diagonal", point(k, bay), point((k + 1) % 3, bay + 1), radius, paint, parent, 6)
