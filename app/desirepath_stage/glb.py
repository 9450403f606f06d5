"""Shapes to binary glTF: unlit surfaces with vertex colours and textures. Knows no scene and no viser."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath_stage.shapes import Shape

_FLOAT, _UINT8, _UINT32 = 5126, 5121, 5125
_REPEAT, _CLAMP, _LINEAR = 10497, 33071, 9729
_NEAREST_MIPMAP = 9985  # bilinear in one level: blending two doubles the cost of a floor in software rendering


@dataclass(frozen=True)
class Surface:
    """One draw call.

    uv: (N, 2) float32 texture coordinates, or None. image: PNG or JPEG bytes that multiply the vertex colours.
    translucent: blend by alpha. repeat: tile the image. marks: (N, 3), what the page wants to know of each corner,
    there the attribute `_mark`; normals do not go along, as nothing is lit and viser makes its own.
    """

    shape: Shape
    uv: NDArray[np.float32] | None = None
    image: bytes | None = None
    translucent: bool = False
    repeat: bool = False
    marks: NDArray[np.float32] | None = None


def to_glb(surfaces: Sequence[Surface]) -> bytes:
    """A GLB file (glTF 2.0, KHR_materials_unlit) with one mesh per surface, frame as given (z up).

    Colours are written as they shall appear (sRGB), where glTF would have them linear: `client/viser_hooks.js` turns
    the renderer's conversions off, which saves a third of a frame in software rendering.
    """
    blob = bytearray()
    views: list[dict[str, int]] = []
    accessors: list[dict[str, Any]] = []
    images: list[dict[str, Any]] = []
    samplers: list[dict[str, int]] = []
    materials: list[dict[str, Any]] = []
    meshes: list[dict[str, Any]] = []

    def add_view(data: bytes) -> int:
        blob.extend(b"\0" * (-len(blob) % 4))
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob.extend(data)
        return len(views) - 1

    def add_accessor(array: NDArray[Any], component: int, kind: str, **more: object) -> int:
        accessors.append(
            {
                "bufferView": add_view(np.ascontiguousarray(array).tobytes()),
                "componentType": component,
                "count": len(array) if kind != "SCALAR" else array.size,
                "type": kind,
                **more,
            }
        )
        return len(accessors) - 1

    for surface in surfaces:
        shape = surface.shape
        positions = shape.positions.astype(np.float32)
        attributes = {
            "POSITION": add_accessor(
                positions, _FLOAT, "VEC3", min=positions.min(0).tolist(), max=positions.max(0).tolist()
            ),
            "COLOR_0": add_accessor(
                np.round(np.clip(shape.colours, 0, 1) * 255).astype(np.uint8), _UINT8, "VEC4", normalized=True
            ),
        }
        if surface.marks is not None:
            attributes["_MARK"] = add_accessor(surface.marks.astype(np.float32), _FLOAT, "VEC3")
        pbr: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        if surface.image is not None:
            if surface.uv is None:
                raise ValueError("surface field 'uv' = None: an image needs texture coordinates, one row per vertex")
            attributes["TEXCOORD_0"] = add_accessor(surface.uv.astype(np.float32), _FLOAT, "VEC2")
            mime = "image/png" if surface.image.startswith(b"\x89PNG") else "image/jpeg"
            images.append({"bufferView": add_view(surface.image), "mimeType": mime})
            wrap = _REPEAT if surface.repeat else _CLAMP
            samplers.append({"magFilter": _LINEAR, "minFilter": _NEAREST_MIPMAP, "wrapS": wrap, "wrapT": wrap})
            pbr["baseColorTexture"] = {"index": len(images) - 1}
        materials.append(
            {
                "pbrMetallicRoughness": pbr,
                "alphaMode": "BLEND" if surface.translucent else "OPAQUE",
                "extensions": {"KHR_materials_unlit": {}},
            }
        )
        indices = add_accessor(shape.faces.astype(np.uint32).reshape(-1), _UINT32, "SCALAR")
        meshes.append({"primitives": [{"attributes": attributes, "indices": indices, "material": len(materials) - 1}]})

    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": list(range(len(meshes)))}],
        "nodes": [{"mesh": i} for i in range(len(meshes))],
        "meshes": meshes,
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    if images:
        document |= {
            "images": images,
            "samplers": samplers,
            "textures": [{"source": i, "sampler": i} for i in range(len(images))],
        }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    blob.extend(b"\0" * (-len(blob) % 4))
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + bytes(blob)
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
