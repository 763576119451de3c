"""Meshes from numbers: boxes, bodies of revolution, sheets, lettering. Metres."""

import math

import bpy
from mathutils import Euler, Matrix, Vector


def _object(name, vertices, faces, material, parent, smooth=False):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.validate()
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    thing.parent = parent
    return thing


def place(thing, at, turn_deg=(0, 0, 0)):
    thing.location = at
    thing.rotation_euler = Euler([math.radians(a) for a in turn_deg])
    return thing


def box(name, size, at, material, parent=None, turn_deg=(0, 0, 0)):
    """A box with its middle at `at`."""
    x, y, z = (s / 2 for s in size)
    corners = [(i, j, k) for i in (-x, x) for j in (-y, y) for k in (-z, z)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return place(_object(name, corners, faces, material, parent), at, turn_deg)


def lathe(name, profile, at, material, parent=None, turn_deg=(0, 0, 0), sides=40):
    """A profile [(radius, z)] turned about the z axis; open at both ends."""
    vertices, faces = [], []
    for radius, z in profile:
        for i in range(sides):
            a = 2 * math.pi * i / sides
            vertices.append((radius * math.cos(a), radius * math.sin(a), z))
    for ring in range(len(profile) - 1):
        for i in range(sides):
            j, low = (i + 1) % sides, ring * sides
            faces.append((low + i, low + j, low + sides + j, low + sides + i))
    return place(_object(name, vertices, faces, material, parent, smooth=True), at, turn_deg)


def rod(name, start, end, radius, material, parent=None, sides=10):
    """A closed cylinder from `start` to `end`."""
    start, end = Vector(start), Vector(end)
    length = (end - start).length
    profile = [(1e-5, 0), (radius, 0), (radius, length), (1e-5, length)]
    thing = lathe(name, profile, (0, 0, 0), material, parent, sides=sides)
    turn = (end - start).to_track_quat("Z", "Y").to_matrix().to_4x4()
    thing.matrix_local = Matrix.Translation(start) @ turn
    thing.data.polygons.foreach_set("use_smooth", [sides > 10] * len(thing.data.polygons))
    return thing


def sheet(name, width, height, material, parent=None, at=(0, 0, 0), turn_deg=(0, 0, 0), wave=None, steps=1):
    """A sheet in its own xy plane; `wave(x, y)` lifts it."""
    vertices, faces = [], []
    for j in range(steps + 1):
        for i in range(steps + 1):
            x, y = width * (i / steps - 0.5), height * (j / steps - 0.5)
            vertices.append((x, y, wave(x, y) if wave else 0.0))
    for j in range(steps):
        for i in range(steps):
            a = j * (steps + 1) + i
            faces.append((a, a + 1, a + steps + 2, a + steps + 1))
    return place(_object(name, vertices, faces, material, parent, smooth=wave is not None), at, turn_deg)


def text(name, words, size, material, parent=None, at=(0, 0, 0), turn_deg=(0, 0, 0)):
    """Lettering as a flat mesh, centred."""
    curve = bpy.data.curves.new(name, "FONT")
    curve.body, curve.size = words, size
    curve.align_x, curve.align_y = "CENTER", "CENTER"
    curve.resolution_u = 3
    curve.fill_mode = "FRONT"
    temporary = bpy.data.objects.new(name + " curve", curve)
    bpy.context.scene.collection.objects.link(temporary)
    bpy.context.view_layer.update()
    mesh = bpy.data.meshes.new_from_object(temporary)
    bpy.data.objects.remove(temporary)
    mesh.materials.clear()
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    thing.parent = parent
    return place(thing, at, turn_deg)
