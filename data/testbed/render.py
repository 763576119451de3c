"""Renders one shot in Blender: linear light, undistorted, a little wider than the picture.

    blender -b --python render.py -- SHOT FOLDER [--object FILE.glb | variant:SEED] [--room SEED]
        [--layer NAME] [--frames A:B:STEP,...] [--lamp-turn DEG]

Writes FOLDER/LAYER/NNNN.exr for each layer of the shot (cases.layers): the light of the groups
`lamp` and `room` apart and the pass `truth` (materials.tag); and FOLDER/mesh.ply, the
satellite in its own frame. Frames that exist are skipped, so a run can be stopped and started
again. Layers: `whole` sees everything; `front` sees the satellite, in which pole and room cut
holes and which they light; `back` sees pole and room, which the satellite still shades and
colours; `base` and `clean` see pole and room without the satellite.
"""

import argparse
import os
import sys
import time

import bpy
import numpy as np
from mathutils import Matrix

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import cases  # noqa: E402
import materials  # noqa: E402
import rooms  # noqa: E402
import satellite  # noqa: E402
import variants  # noqa: E402

STRIDES = (12, 4, 2, 1)


def arguments():
    parser = argparse.ArgumentParser()
    parser.add_argument("shot", choices=sorted(cases.SHOTS))
    parser.add_argument("folder")
    parser.add_argument("--object", help="a .glb, or variant:SEED, to film in place of the mock-up")
    parser.add_argument("--room", type=int, help="seed of other things beside the green screen")
    parser.add_argument("--frames", default="::", help="start:stop:step, or several with commas between")
    parser.add_argument("--lamp-turn", type=float, default=0.0,
                        help="the lamp stands elsewhere: turned about the room's z axis by so many degrees")
    parser.add_argument("--layer", help="only this layer")
    return parser.parse_args(sys.argv[sys.argv.index("--") + 1 :])


def empty_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    layer = scene.view_layers[0]
    layer.name = "L"
    layer.use_pass_combined = True
    for group in ("lamp", "room"):
        layer.lightgroups.add(name=group)
    aov = layer.aovs.add()
    aov.name, aov.type = "truth", "COLOR"
    return scene


def quality(scene, shot):
    """Few samples and bounces: the sensor's noise hides what is left."""
    scene.render.engine = "CYCLES"
    c = scene.cycles
    c.device, c.samples, c.use_adaptive_sampling, c.use_denoising = "CPU", shot.samples, False, False
    c.max_bounces, c.diffuse_bounces, c.glossy_bounces = shot.bounces, min(2, shot.bounces), min(2, shot.bounces)
    c.transmission_bounces, c.volume_bounces, c.transparent_max_bounces = 0, 0, 2
    c.caustics_reflective = c.caustics_refractive = False
    c.blur_glossy, c.sample_clamp_indirect = 1.0, shot.clamp
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.use_persistent_data = True
    scene.render.use_motion_blur = shot.shutter > 0
    scene.render.motion_blur_shutter = max(shot.shutter, 0.01)
    c.motion_blur_position = "CENTER"
    image = scene.render.image_settings
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "16", "ZIP"
    scene.view_settings.view_transform = "Raw"


def camera(scene):
    thing = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    thing.data.clip_start = 0.05
    scene.collection.objects.link(thing)
    scene.camera = thing
    return thing


def set_layer(scene, shot, eye, held, name):
    """Make the scene show one layer; `held`: the objects of the satellite."""
    _, scene.cycles.samples, density = cases.layers(shot)[name]
    width, height, f = cases.render_size(shot, density)
    eye.data.sensor_fit, eye.data.sensor_width, eye.data.lens = "HORIZONTAL", 36.0, f / width * 36.0
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = name == "front"
    scene.render.use_motion_blur = name in ("front", "whole") and shot.shutter > 0
    for thing in scene.objects:
        if thing.type == "LIGHT":
            continue
        if thing in held:
            thing.visible_camera = name in ("whole", "front")
            thing.hide_render = name in ("base", "clean")
        else:
            thing.is_holdout = name == "front"


def pose(thing, shot, i):
    """Blender's camera looks along -z with y up."""
    R, t = cases.camera_from_world(shot, i)
    world = Matrix.Identity(4)
    for row in range(3):
        for column in range(3):
            world[row][column] = R[column][row] * (1, -1, -1)[column]
        world[row][3] = float(-(R.T @ t)[row])
    thing.matrix_world = world


def thing_to_film(name):
    """The mock-up, a glTF model, or another satellite drawn at random (`variant:SEED`)."""
    if not name:
        return satellite.build()
    kind, _, seed = name.partition(":")
    return variants.build(int(seed)) if kind == "variant" else glb(name)


def glb(path):
    """A glTF model as `Satellite`, scaled to 1.0 m and centred a little off the axis."""
    before = set(bpy.data.objects)
    # Debian 12's importer names what its numpy no longer has.
    for name, kind in (("bool", bool), ("object", object), ("float", float), ("int", int)):
        if not hasattr(np, name):
            setattr(np, name, kind)
    bpy.ops.import_scene.gltf(filepath=os.path.abspath(path))
    things = [o for o in bpy.data.objects if o not in before]
    root = bpy.data.objects.new("Satellite", None)
    bpy.context.scene.collection.objects.link(root)
    bpy.context.view_layer.update()
    corners = [o.matrix_world @ v.co for o in things if o.type == "MESH" for v in o.data.vertices]
    low = [min(c[k] for c in corners) for k in range(3)]
    high = [max(c[k] for c in corners) for k in range(3)]
    scale = 1.0 / max(b - a for a, b in zip(low, high))
    middle = Matrix.Translation([-(a + b) / 2 for a, b in zip(low, high)])
    move = Matrix.Translation(cases.MOUNT_M) @ Matrix.Scale(scale, 4) @ middle
    for o in things:
        if o.parent is None:
            o.parent = root
            o.matrix_world = move @ o.matrix_world
    return root


def descendants(root):
    return [root] + [d for child in root.children for d in descendants(child)]


def truth_materials(root, pole, shot):
    for kind, things in (("satellite", descendants(root)), ("pole", pole)):
        used = {slot.material for o in things for slot in o.material_slots if slot.material}
        for material in used:
            material.use_nodes = True
            materials.tag(material, kind, shot.distance_m)


def write_mesh(root, path):
    """The satellite's triangles in the satellite frame, binary PLY; returns the vertices [N, 3]."""
    vertices, faces, base = [], [], 0
    for o in descendants(root):
        if o.type != "MESH":
            continue
        o.data.calc_loop_triangles()
        vertices += [root.matrix_world.inverted() @ o.matrix_world @ v.co for v in o.data.vertices]
        faces += [[base + k for k in triangle.vertices] for triangle in o.data.loop_triangles]
        base += len(o.data.vertices)
    face = np.zeros(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    face["n"], face["v"] = 3, np.array(faces)
    head = (
        "ply\nformat binary_little_endian 1.0\ncomment satellite frame, metres\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with open(path, "wb") as file:
        file.write(head.encode() + np.array(vertices, "<f4").tobytes() + face.tobytes())
    return np.array(vertices)


def crop(scene, shot, i, density, vertices):
    """Render only the rectangle in which the satellite is."""
    R, t = cases.camera_from_satellite(shot, i)
    p = vertices @ R.T + t
    width, height, f = cases.render_size(shot, density)
    x = (f * p[:, 0] / p[:, 2] + width / 2 + np.array([[-6], [6]])) / width
    y = (height / 2 - f * p[:, 1] / p[:, 2] + np.array([[-6], [6]])) / height
    scene.render.use_border, scene.render.use_crop_to_border = True, False
    scene.render.border_min_x, scene.render.border_max_x = max(0.0, x.min()), min(1.0, x.max())
    scene.render.border_min_y, scene.render.border_max_y = max(0.0, y.min()), min(1.0, y.max())


def yaw(root, shot):
    for i in range(-1, shot.frames + 1):
        root.rotation_euler = (0, 0, cases.yaw_angle(shot, i))
        root.keyframe_insert("rotation_euler", index=2, frame=i)
    for curve in root.animation_data.action.fcurves:
        for key in curve.keyframe_points:
            key.interpolation = "LINEAR"
    root.rotation_euler = (0, 0, 0)


def turn_lamp(scene, degrees):
    """The light of the group `lamp` goes round the room's z axis; its housing stays."""
    turn = Matrix.Rotation(np.radians(degrees), 4, "Z")
    for thing in scene.objects:
        if thing.type == "LIGHT" and thing.lightgroup == "lamp":
            thing.matrix_world = turn @ thing.matrix_world


def render(scene, shot, eye, vertices, folder, name, wanted):
    """One layer's frames as far as they are missing, with the processor seconds of each in
    cpu_s.txt."""
    os.makedirs(f"{folder}/{name}", exist_ok=True)
    spent = time.process_time()
    frames, _, density = cases.layers(shot)[name]
    scene.render.use_border = False
    for i in wanted if frames > 1 else (0,):
        target = os.path.abspath(f"{folder}/{name}/{i:04d}.exr")
        if os.path.exists(target):
            continue
        scene.frame_set(i)
        pose(eye, shot, i)
        if name == "front":
            crop(scene, shot, i, density, vertices)
        scene.cycles.seed = 0 if shot.layers == "static" and name in ("base", "back") else i
        scene.render.filepath = target + ".part.exr"
        bpy.ops.render.render(write_still=True)
        os.replace(target + ".part.exr", target)
        now = time.process_time()
        with open(f"{folder}/cpu_s.txt", "a") as log:
            log.write(f"{name} {i} {now - spent:.2f}\n")
        spent = now


def main():
    options = arguments()
    shot = cases.SHOTS[options.shot]
    os.makedirs(options.folder, exist_ok=True)
    scene = empty_scene()
    root = thing_to_film(options.object)
    pole = rooms.green_screen(shot, options.room) if shot.room == "green_screen" else getattr(rooms, shot.room)(shot)
    truth_materials(root, pole, shot)
    quality(scene, shot)
    eye = camera(scene)
    bpy.context.view_layer.update()
    vertices = write_mesh(root, os.path.join(options.folder, "mesh.ply"))
    if shot.path == "yaw":
        yaw(root, shot)
    turn_lamp(scene, options.lamp_turn)
    parts = [slice(*(int(x) if x else None for x in part.split(":"))) for part in options.frames.split(",")]
    chosen = sorted({i for part in parts for i in range(shot.frames)[part]})
    # Coarse to fine, so that a part of the shot can be developed (`--every`) long before all of it
    # is there.
    for stride in STRIDES:
        for name in [options.layer] if options.layer else cases.layers(shot):
            set_layer(scene, shot, eye, set(descendants(root)), name)
            render(scene, shot, eye, vertices, options.folder, name, chosen[::stride])


main()
