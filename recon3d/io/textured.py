"""Textured meshes in files that other programs open."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.io.files import atomic_path, write_image, write_text

TEXTURED_SUFFIXES = (".glb", ".obj")

_FLOAT, _UNSIGNED = 5126, 5125  # glTF's component types
_VERTICES, _INDICES = 34962, 34963  # and what their buffers are for


def write_textured(
    path: Path | str, mesh: o3d.geometry.TriangleMesh, places: NDArray[np.float64], image: NDArray[np.uint8]
) -> list[Path]:
    """Write a mesh and a picture of its surface as GLB, or as OBJ with a material (MTL) and a picture (PNG) beside it.

    The colours are those of the photographs, light and shadow included: the material asks to be shown as it is
    (KHR_materials_unlit), and is matt where a program does not know of that.

    Parameters
    ----------
    mesh : with vertex normals, in the frame of the file, which most programs take to have metres and y up.
    places : (n_triangles, 3, 2) of the triangles' corners in the image, in [0, 1]: to the right, downwards.
    image : (rows, columns, 3) RGB.

    Returns
    -------
    list
        The files that were written, the mesh's first.

    Raises
    ------
    ArgumentError : the file's name ends otherwise.
    OSError : a file could not be written.

    References
    ----------
    Khronos Group, "glTF 2.0 Specification", 2021 (also ISO/IEC 12113:2022).
    """
    path = Path(path)
    if path.suffix.lower() not in TEXTURED_SUFFIXES:
        raise ArgumentError(f"{path}: a textured mesh is written as {', '.join(TEXTURED_SUFFIXES)}")
    if path.suffix.lower() == ".obj":
        return _write_obj(path, mesh, places, image)
    with atomic_path(path) as temporary:
        temporary.write_bytes(_glb(path.stem, mesh, places, image))
    return [path]


def _glb(name: str, mesh: o3d.geometry.TriangleMesh, places: NDArray[np.float64], image: NDArray[np.uint8]) -> bytes:
    """A binary glTF file: a header, the scene as JSON, and the arrays that it names."""
    points, normals, uv, triangles = _split(mesh, places)
    arrays = [
        (points.astype("<f4"), "VEC3", _FLOAT, _VERTICES),
        (normals.astype("<f4"), "VEC3", _FLOAT, _VERTICES),
        (uv.astype("<f4"), "VEC2", _FLOAT, _VERTICES),
        (triangles.astype("<u4").ravel(), "SCALAR", _UNSIGNED, _INDICES),
    ]
    contents = [array.tobytes() for array, *_ in arrays] + [_png(image)]
    starts = np.cumsum([0, *(len(_aligned(content, b"\0")) for content in contents)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(content)}
        for start, content in zip(starts, contents, strict=False)
    ]
    accessors = []
    for n, (array, kind, component, target) in enumerate(arrays):
        views[n]["target"] = target
        accessors.append({"bufferView": n, "componentType": component, "count": len(array), "type": kind})
    accessors[0] |= {"min": arrays[0][0].min(axis=0).tolist(), "max": arrays[0][0].max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0", "generator": "recon3d"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "meshes": [
            {
                "name": name,
                "primitives": [
                    {"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}
                ],
            }
        ],
        "materials": [
            {
                "name": "photographs",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "metallicFactor": 0.0,
                    "roughnessFactor": 1.0,
                },
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": [{"mimeType": "image/png", "bufferView": len(arrays)}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": starts[-1]}],
    }
    text = _aligned(json.dumps(document, separators=(",", ":")).encode("utf-8"), b" ")
    binary = b"".join(_aligned(content, b"\0") for content in contents)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _write_obj(
    path: Path, mesh: o3d.geometry.TriangleMesh, places: NDArray[np.float64], image: NDArray[np.uint8]
) -> list[Path]:
    """OBJ, MTL and PNG of the same name; OBJ's v runs upwards, and its numbers begin at one."""
    corners, index = _distinct(places.reshape(-1, 2))
    uv = np.column_stack([corners[:, 0], 1 - corners[:, 1]])
    of_points = np.asarray(mesh.triangles) + 1
    of_uv = index.reshape(-1, 3) + 1
    lines = [f"mtllib {path.stem}.mtl", f"o {path.stem}"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(mesh.vertices).tolist()]
    lines += [f"vt {u:.7f} {v:.7f}" for u, v in uv.tolist()]
    lines += [f"vn {x:.5f} {y:.5f} {z:.5f}" for x, y, z in _unit_normals(mesh).tolist()]
    lines += ["usemtl photographs"]
    lines += [
        f"f {a}/{i}/{a} {b}/{j}/{b} {c}/{k}/{c}"
        for (a, b, c), (i, j, k) in zip(of_points.tolist(), of_uv.tolist(), strict=True)
    ]
    picture, material = path.with_suffix(".png"), path.with_suffix(".mtl")
    write_image(picture, image)
    write_text(material, f"newmtl photographs\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {picture.name}\n")
    write_text(path, "\n".join(lines) + "\n")
    return [path, material, picture]


def _split(
    mesh: o3d.geometry.TriangleMesh, places: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Points, unit normals (n, 3), places (n, 2) and triangles (m, 3), a vertex for each place that it has."""
    index = np.asarray(mesh.triangles).ravel()
    _, first, vertex = np.unique(
        np.column_stack([index, *_bits(places.reshape(-1, 2))]), axis=0, return_index=True, return_inverse=True
    )
    index = index[first]
    return (
        np.asarray(mesh.vertices)[index],
        _unit_normals(mesh)[index],
        places.reshape(-1, 2)[first],
        vertex.reshape(-1, 3),
    )


def _unit_normals(mesh: o3d.geometry.TriangleMesh) -> NDArray[np.float64]:
    """(n, 3) normals of the vertices; upwards where there is none."""
    normals = np.asarray(mesh.vertex_normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.where(length > 0, normals / np.maximum(length, 1e-300), [0.0, 1.0, 0.0]))


def _distinct(places: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The distinct ones among places (n, 2), and (n,) which each is."""
    _, first, index = np.unique(np.column_stack(_bits(places)), axis=0, return_index=True, return_inverse=True)
    return places[first], index.ravel()


def _bits(places: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Places (n, 2), each coordinate as a whole number that only equal ones share, in single precision."""
    return [places[:, axis].astype(np.float32).view(np.int32).astype(np.int64) for axis in range(2)]


def _png(image: NDArray[np.uint8]) -> bytes:
    """A picture (rows, columns, 3) RGB as PNG."""
    done, content = cv2.imencode(".png", image[..., ::-1])
    if not done:
        raise OSError("OpenCV could not encode the texture as PNG")
    return bytes(content)


def _aligned(content: bytes, filler: bytes) -> bytes:
    """Filled up to a multiple of four bytes."""
    return content + filler * (-len(content) % 4)
