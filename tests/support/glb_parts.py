"""Binary glTF for tests, by its specification alone: sheets and boxes of several materials."""

from __future__ import annotations

import io
import json
import struct
import zlib

import numpy as np
from PIL import Image

SHEET = (np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]),
         np.array([[0, 1, 2], [0, 2, 3]]))
# Row 0 of an image is at v = 0.
SHEET_UV = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])


def png(array, mode=None):
    """The bytes of a PNG of an array."""
    data = io.BytesIO()
    Image.fromarray(np.asarray(array), mode).save(data, "PNG")
    return data.getvalue()


def png_head(width, height):
    """A PNG's beginning, which says how large it is."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))  # noqa: E731
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(bytes(1000))))


def material(name="", grey=1.0, metal=0.0, rough=1.0, **more):
    """A material of a grey, and what else its `pbrMetallicRoughness` has."""
    return {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [grey, grey, grey, 1.0], "metallicFactor": metal,
                                                   "roughnessFactor": rough, **more}}


def glb(path, pieces, materials, images=(), **more):
    """Write a file of pieces (vertices, facets, number of the material or None, node, uv): a node for each."""
    blob, views, accessors, meshes, nodes = b"", [], [], [], []

    def view(data):
        nonlocal blob
        blob += b"\0" * (-len(blob) % 4)
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob += data
        return len(views) - 1

    def accessor(array, kind, component):
        accessors.append({"bufferView": view(array.tobytes()), "componentType": component, "count": len(array),
                          "type": kind})
        return len(accessors) - 1

    for vertices, facets, number, node, uv in pieces:
        primitive = {"attributes": {"POSITION": accessor(np.asarray(vertices, "<f4"), "VEC3", 5126)},
                     "indices": accessor(np.asarray(facets, "<u4").ravel(), "SCALAR", 5125)}
        if number is not None:
            primitive["material"] = number
        if uv is not None:
            primitive["attributes"]["TEXCOORD_0"] = accessor(np.asarray(uv, "<f4"), "VEC2", 5126)
        meshes.append({"primitives": [primitive]})
        nodes.append({"mesh": len(meshes) - 1, **(node or {})})
    about = {"asset": {"version": "2.0"}, "nodes": nodes, "meshes": meshes, "accessors": accessors,
             "materials": materials,
             "images": [image if isinstance(image, dict) else {"bufferView": view(image), "mimeType": "image/png"}
                        for image in images],
             "textures": [{"source": k} for k in range(len(images))], **more}
    about |= {"bufferViews": views, "buffers": [{"byteLength": len(blob)}]}
    text = json.dumps({key: value for key, value in about.items() if value != []}).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob))
                     + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob)
    return path


def sheet(number, node=None, uv=None, turned=False):
    """A piece of 1 m x 1 m that faces +z, or -z."""
    vertices, facets = SHEET
    return vertices, facets[:, ::-1] if turned else facets, number, node, uv
