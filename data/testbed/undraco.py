"""glTF models whose meshes Draco has compressed, as plain ones: Debian's Blender has no decoder,
its package draco has.

    python3 undraco.py COMPRESSED.glb PLAIN.glb
"""
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile

import numpy as np

EXTENSION = "KHR_draco_mesh_compression"
FLOAT, UNSIGNED = 5126, 5125
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


def read_glb(path):
    """Description and binary chunk."""
    with open(path, "rb") as file:
        data = file.read()
    if data[:4] != b"glTF":
        raise ValueError(f"{path} is no .glb")
    chunks, at = {}, 12
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, at)
        chunks[kind] = data[at + 8 : at + 8 + size]
        at += 8 + size
    return json.loads(chunks[JSON_CHUNK]), chunks.get(BINARY_CHUNK, b"")


def decoded(buffer):
    """Corners of the triangles: (name, [N, width] float32) by attribute, and [3 T] indices."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = os.path.join(folder, "mesh.drc"), os.path.join(folder, "mesh.obj")
        with open(source, "wb") as file:
            file.write(buffer)
        subprocess.run(["draco_decoder", "-i", source, "-o", target], check=True, stdout=subprocess.DEVNULL)
        tables, corners = {"v": [], "vt": [], "vn": []}, []
        with open(target) as lines:
            for line in lines:
                kind, *words = line.split() or [""]
                if kind in tables:
                    tables[kind].append([float(w) for w in words])
                elif kind == "f":
                    corners += [tuple(int(i or 0) for i in word.split("/")) for word in words]
    unique = sorted(set(corners))
    number = {corner: i for i, corner in enumerate(unique)}
    attributes = {}
    for place, (kind, name, width) in enumerate((("v", "POSITION", 3), ("vt", "TEXCOORD_0", 2), ("vn", "NORMAL", 3))):
        if tables[kind] and all(len(c) > place and c[place] > 0 for c in unique):
            values = np.array(tables[kind], np.float32)[:, :width]
            attributes[name] = values[[c[place] - 1 for c in unique]]
    if "TEXCOORD_0" in attributes:  # .obj counts from below, glTF from above
        attributes["TEXCOORD_0"][:, 1] = 1 - attributes["TEXCOORD_0"][:, 1]
    return attributes, np.array([number[c] for c in corners], np.uint32)


def plain(description, binary):
    """The same model without the extension; returns the new binary chunk."""
    views, accessors = description["bufferViews"], description["accessors"]
    out = bytearray(binary)

    def accessor(array, kind, component):
        out.extend(bytes(-len(out) % 4))
        views.append({"buffer": 0, "byteOffset": len(out), "byteLength": array.nbytes})
        entry = {"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind}
        if kind == "VEC3":
            entry |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        out.extend(array.tobytes())
        accessors.append(entry)
        return len(accessors) - 1

    for primitive in (p for mesh in description["meshes"] for p in mesh["primitives"]):
        compressed = primitive.get("extensions", {}).pop(EXTENSION, None)
        if compressed is None:
            continue
        view = views[compressed["bufferView"]]
        first = view.get("byteOffset", 0)
        attributes, indices = decoded(binary[first : first + view["byteLength"]])
        kinds = {2: "VEC2", 3: "VEC3"}
        primitive["attributes"] = {n: accessor(a, kinds[a.shape[1]], FLOAT) for n, a in attributes.items()}
        primitive["indices"] = accessor(indices, "SCALAR", UNSIGNED)
    for key in ("extensionsUsed", "extensionsRequired"):
        description[key] = [e for e in description.get(key, []) if e != EXTENSION]
        if not description[key]:
            del description[key]
    out.extend(bytes(-len(out) % 4))
    description["buffers"][0]["byteLength"] = len(out)
    return bytes(out)


def write_glb(path, description, binary):
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(binary)
    with open(path, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, size))
        file.write(struct.pack("<II", len(text), JSON_CHUNK) + text)
        file.write(struct.pack("<II", len(binary), BINARY_CHUNK) + binary)


def main():
    source, target = sys.argv[1:3]
    if not shutil.which("draco_decoder"):
        sys.exit(f"draco_decoder is missing: {source} is compressed with it (apt-get install draco)")
    description, binary = read_glb(source)
    write_glb(target, description, plain(description, binary))


if __name__ == "__main__":
    main()
