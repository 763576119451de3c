"""Materials of the test bed: Cycles shader nodes, no image files."""

import bpy


class Nodes:
    """A material under construction."""

    def __init__(self, name):
        self.material = bpy.data.materials.new(name)
        self.material.use_nodes = True
        self.tree = self.material.node_tree
        self.shader = self.tree.nodes["Principled BSDF"]

    def add(self, kind, **settings):
        """A node; settings are attributes or, where there is none of that name, inputs."""
        node = self.tree.nodes.new(kind)
        for key, value in settings.items():
            if hasattr(node, key):
                setattr(node, key, value)
            else:
                node.inputs[key.replace("_", " ").title()].default_value = value
        return node

    def link(self, source, target):
        self.tree.links.new(source, target)

    def position(self):
        """Coordinates of the mesh's own frame, metres."""
        return self.add("ShaderNodeTexCoord").outputs["Object"]

    def math(self, operation, a, b):
        node = self.add("ShaderNodeMath", operation=operation)
        self._set(node.inputs[0], a)
        self._set(node.inputs[1], b)
        return node.outputs[0]

    def vector_math(self, operation, a, b):
        node = self.add("ShaderNodeVectorMath", operation=operation)
        self._set(node.inputs[0], a)
        self._set(node.inputs[1], b)
        return node.outputs[0]

    def _set(self, socket, value):
        if isinstance(value, bpy.types.NodeSocket):
            self.link(value, socket)
        else:
            socket.default_value = value

    def surface(self, colour=None, roughness=0.5, metallic=0.0, specular=0.5):
        if colour is not None:
            self._set(self.shader.inputs["Base Color"], colour)
        self.shader.inputs["Roughness"].default_value = roughness
        self.shader.inputs["Metallic"].default_value = metallic
        self.shader.inputs["Specular"].default_value = specular
        return self.material


def plain(name, rgb, roughness=0.6, metallic=0.0):
    """One colour."""
    return Nodes(name).surface((*rgb, 1.0), roughness, metallic)


def foil(name, rgb, cell=38.0):
    """Crinkled foil: facets (the cells of two Voronoi textures) tilt the normal and tint."""
    n = Nodes(name)
    normal = n.add("ShaderNodeNewGeometry").outputs["Normal"]
    tint = None
    for scale, tilt in ((cell, 0.75), (2.7 * cell, 0.45)):
        cells = n.add("ShaderNodeTexVoronoi", scale=scale)
        n.link(n.position(), cells.inputs["Vector"])
        offset = n.vector_math("SUBTRACT", cells.outputs["Color"], (0.5, 0.5, 0.5))
        normal = n.vector_math("ADD", normal, n.vector_math("MULTIPLY", offset, (tilt, tilt, tilt)))
        tint = cells.outputs["Color"] if tint is None else tint
    normal = n.vector_math("NORMALIZE", normal, (0.0, 0.0, 0.0))
    n.link(normal, n.shader.inputs["Normal"])
    split = n.add("ShaderNodeSeparateXYZ")
    n.link(tint, split.inputs[0])
    shade = n.math("MULTIPLY_ADD", split.outputs[0], 0.45)
    shade.node.inputs[2].default_value = 0.62
    colour = n.vector_math("MULTIPLY", (*rgb,), shade)
    return n.surface(colour, roughness=0.24, metallic=0.9)


def solar_cells(name):
    """Dark blue cells with bright gaps, each cell with a shade of its own."""
    n = Nodes(name)
    grid = n.add("ShaderNodeTexBrick", offset=0.0, squash=1.0)
    n.link(n.position(), grid.inputs["Vector"])
    values = {
        "Color1": (0.010, 0.022, 0.10, 1),
        "Color2": (0.030, 0.055, 0.20, 1),
        "Mortar": (0.62, 0.62, 0.58, 1),
        "Scale": 1.0,
        "Mortar Size": 0.0022,
        "Mortar Smooth": 0.1,
        "Bias": 0.0,
        "Brick Width": 0.048,
        "Row Height": 0.036,
    }
    for key, value in values.items():
        grid.inputs[key].default_value = value
    return n.surface(grid.outputs["Color"], roughness=0.28)


def mottled(name, dark, light, scale=6.0, roughness=0.8, detail=4.0, stretch=(1, 1, 1)):
    """Noise between two colours: floors, walls, card, wood (stretched)."""
    n = Nodes(name)
    noise = n.add("ShaderNodeTexNoise", scale=scale, detail=detail)
    noise.inputs["Roughness"].default_value = 0.68
    n.link(n.vector_math("MULTIPLY", n.position(), stretch), noise.inputs["Vector"])
    ramp = n.add("ShaderNodeValToRGB")
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.36, 0.64
    ramp.color_ramp.elements[0].color = (*dark, 1)
    ramp.color_ramp.elements[1].color = (*light, 1)
    n.link(noise.outputs["Fac"], ramp.inputs["Fac"])
    return n.surface(ramp.outputs["Color"], roughness, specular=0.2)


def patches(name, rgb, contrast=0.9, scale=14.0):
    """Voronoi cells of random brightness: posters and printed matter."""
    n = Nodes(name)
    cells = n.add("ShaderNodeTexVoronoi", scale=scale, distance="CHEBYCHEV")
    n.link(n.position(), cells.inputs["Vector"])
    split = n.add("ShaderNodeSeparateXYZ")
    n.link(cells.outputs["Color"], split.inputs[0])
    shade = n.math("MULTIPLY_ADD", split.outputs[0], contrast)
    shade.node.inputs[2].default_value = 1.0 - contrast
    return n.surface(n.vector_math("MULTIPLY", (*rgb,), shade), 0.7)


def tag(material, kind, depth_offset):
    """Add the truth to a material: a pass `truth` with red = coverage by the satellite, green
    = coverage by the pole, blue = (depth along the optical axis - depth_offset) where the
    satellite is. It goes through the same filter and shutter as the picture."""
    tree = material.node_tree
    out = tree.nodes.new("ShaderNodeOutputAOV")
    out.name = "truth"
    join = tree.nodes.new("ShaderNodeCombineXYZ")
    join.inputs[0].default_value = 1.0 if kind == "satellite" else 0.0
    join.inputs[1].default_value = 1.0 if kind == "pole" else 0.0
    if kind == "satellite":
        depth = tree.nodes.new("ShaderNodeCameraData").outputs["View Z Depth"]
        shift = tree.nodes.new("ShaderNodeMath")
        shift.operation = "SUBTRACT"
        tree.links.new(depth, shift.inputs[0])
        shift.inputs[1].default_value = depth_offset
        tree.links.new(shift.outputs[0], join.inputs[2])
    tree.links.new(join.outputs[0], out.inputs["Color"])
