"""Meshes for 3D printers: millimetres, z up, closed."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import OpenMeshError
from recon3d.io.files import atomic_path

PRINT_SUFFIXES = (".3mf", ".stl")

_CONTENT_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""

_RELATIONSHIPS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""

_MODEL = """<?xml version="1.0" encoding="UTF-8"?>
<model unit="millimeter" xml:lang="en-US" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">
<resources><object id="1" type="model"><mesh>
<vertices>
{vertices}
</vertices>
<triangles>
{triangles}
</triangles>
</mesh></object></resources>
<build><item objectid="1"/></build>
</model>
"""


def write_print(
    path: Path | str, mesh: o3d.geometry.TriangleMesh, print_from_world: NDArray[np.float64] | None = None
) -> Path:
    """Write a closed mesh for a printer, standing on z = 0, as 3MF or STL; returns the path.

    Parameters
    ----------
    print_from_world : (4, 4) from the mesh's frame to one in millimetres whose z points up: a rotation, a scale and a
        shift; None: the mesh is in such a frame.

    Raises
    ------
    OpenMeshError : the mesh has a boundary, or edges or vertices where it is no surface.

    References
    ----------
    3MF Consortium, "3D Manufacturing Format: Core Specification and Reference Guide", 1.3.0.
    """
    path = Path(path)
    if not is_closed(mesh):
        raise OpenMeshError(
            f"{path}: expected a closed mesh to print, got one with open boundaries; keep what was not measured "
            "(--keep-unsupported), which closes it, or write another format"
        )
    solid = o3d.geometry.TriangleMesh(mesh.vertices, mesh.triangles)
    if print_from_world is not None:
        solid.transform(print_from_world)
    middle, low = solid.get_axis_aligned_bounding_box().get_center(), solid.get_min_bound()
    points = np.asarray(solid.vertices) - [middle[0], middle[1], low[2]]
    triangles = np.asarray(solid.triangles)
    with atomic_path(path) as temporary:
        if path.suffix.lower() == ".3mf":
            _write_3mf(temporary, points, triangles)
        else:
            _write_stl(temporary, points, triangles)
    return path


def is_closed(mesh: o3d.geometry.TriangleMesh) -> bool:
    """Whether a mesh bounds a solid: two triangles at each edge that agree which side is out, one fan at each vertex.

    Pieces may cross each other.
    """
    triangles = np.asarray(mesh.triangles).astype(np.int64)
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    n = len(mesh.vertices)
    forwards, backwards = np.sort(start * n + end), np.sort(end * n + start)
    directed_once = bool(len(forwards)) and bool((np.diff(forwards) > 0).all())
    return directed_once and bool((forwards == backwards).all()) and bool(mesh.is_vertex_manifold())


def _write_3mf(path: Path, points: NDArray[np.float64], triangles: NDArray[np.int32]) -> None:
    """Vertices (n, 3) and triangles (m, 3) as the one object of a 3MF package; four digits are a tenth of a micron."""
    model = _MODEL.format(
        vertices="\n".join(f'<vertex x="{x:.4f}" y="{y:.4f}" z="{z:.4f}"/>' for x, y, z in points.tolist()),
        triangles="\n".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles.tolist()),
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("[Content_Types].xml", _CONTENT_TYPES)
        package.writestr("_rels/.rels", _RELATIONSHIPS)
        package.writestr("3D/3dmodel.model", model)


def _write_stl(path: Path, points: NDArray[np.float64], triangles: NDArray[np.int32]) -> None:
    """Binary STL of vertices (n, 3) and triangles (m, 3)."""
    corners = points[triangles].astype("<f4")
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    facets = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
    facets["normal"], facets["corners"] = normals, corners
    path.write_bytes(b"recon3d".ljust(80) + np.uint32(len(facets)).astype("<u4").tobytes() + facets.tobytes())
