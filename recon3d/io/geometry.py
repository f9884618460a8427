"""Open3D geometry into files, and its arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.io.files import atomic_path

if TYPE_CHECKING:  # it takes a second to import, and PLY files need none
    import trimesh

Shape = TypeVar("Shape", bound=o3d.geometry.TriangleMesh | o3d.geometry.PointCloud)
Geometry = o3d.geometry.TriangleMesh | o3d.geometry.PointCloud | o3d.geometry.VoxelGrid


MESH_SUFFIXES = (".ply", ".obj", ".glb", ".stl")


_PLY_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "uint": "<u4", "uchar": "u1"}


_ARRAYS = {
    "vertices": o3d.utility.Vector3dVector,
    "vertex_normals": o3d.utility.Vector3dVector,
    "vertex_colors": o3d.utility.Vector3dVector,
    "triangles": o3d.utility.Vector3iVector,
    "triangle_normals": o3d.utility.Vector3dVector,
    "triangle_uvs": o3d.utility.Vector2dVector,
    "triangle_material_ids": o3d.utility.IntVector,
    "points": o3d.utility.Vector3dVector,
    "normals": o3d.utility.Vector3dVector,
    "colors": o3d.utility.Vector3dVector,
    "covariances": o3d.utility.Matrix3dVector,
}
"""Open3D's own vectors, by the names that its legacy meshes and clouds give them."""


def write_geometry(
    path: Path | str,
    geometry: Geometry,
    *,
    support: NDArray[np.int64] | None = None,
    uncertainty: NDArray[np.float64] | None = None,
    confidence: NDArray[np.float64] | None = None,
) -> Path:
    """Write a mesh (PLY, OBJ, GLB, STL), a point cloud (PLY) or a voxel grid (PLY); returns the path.

    Parameters
    ----------
    support : (n_vertices,) how many views see each vertex of a mesh, for ``read_support``; kept by PLY alone.
    uncertainty : (n_vertices,) predicted distance of each vertex of a mesh to the true surface, world units, for
        ``read_uncertainty``; kept by PLY alone.
    confidence : (n_points,) in each point of a cloud, kept as a property of that name.

    Raises
    ------
    ArgumentError : the geometry cannot be written in that format.
    OSError : the file could not be written.
    """
    path = Path(path)
    allowed = MESH_SUFFIXES if isinstance(geometry, o3d.geometry.TriangleMesh) else (".ply",)
    if path.suffix.lower() not in allowed:
        raise ArgumentError(f"{path}: a {type(geometry).__name__} is written as {', '.join(allowed)}")
    for name, values in (("support", support), ("uncertainty", uncertainty)):
        if values is not None and (
            not isinstance(geometry, o3d.geometry.TriangleMesh) or values.shape != (len(geometry.vertices),)
        ):
            raise ArgumentError(
                f"{path}: expected a number for each vertex of a mesh as {name}, got shape {values.shape}"
            )
    with atomic_path(path) as temporary:
        if isinstance(geometry, o3d.geometry.TriangleMesh):
            if path.suffix.lower() == ".ply":
                done = _write_ply(temporary, geometry, support, uncertainty)
            else:  # Open3D 0.20 cannot read the GLB that it writes
                done = bool(_to_trimesh(geometry).export(temporary, file_type=path.suffix[1:].lower()))
        elif isinstance(geometry, o3d.geometry.PointCloud):
            cloud = o3d.t.geometry.PointCloud.from_legacy(geometry, o3d.core.float64)
            if geometry.has_colors():
                cloud.point.colors = o3d.core.Tensor.from_numpy(_eight_bits(geometry.colors))
            if confidence is not None:
                cloud.point.confidence = o3d.core.Tensor.from_numpy(confidence[:, None])
            done = o3d.t.io.write_point_cloud(temporary, cloud)
        else:
            done = o3d.io.write_voxel_grid(temporary, geometry)
        if not done:
            raise OSError(f"{path}: Open3D could not write the {type(geometry).__name__}")
    return path


def geometry_arrays(geometry: o3d.geometry.TriangleMesh | o3d.geometry.PointCloud) -> dict[str, NDArray[Any]]:
    """All arrays of a legacy mesh or cloud, its textures among them; these pickle, the geometry does not."""
    arrays = {name: np.array(getattr(geometry, name)) for name in _ARRAYS if hasattr(geometry, name)}
    textures = enumerate(getattr(geometry, "textures", ()))
    return arrays | {f"texture {n}": np.array(texture) for n, texture in textures}


def from_arrays(geometry: Shape, arrays: Mapping[str, NDArray[Any]]) -> Shape:
    """Fill an empty legacy mesh or cloud with the arrays of another; returns it."""
    for name, array in arrays.items():
        if name in _ARRAYS and array.size:
            setattr(geometry, name, _ARRAYS[name](array))
    textures: list[Any] = [array for name, array in arrays.items() if name not in _ARRAYS]
    if textures and isinstance(geometry, o3d.geometry.TriangleMesh):
        geometry.textures = [o3d.geometry.Image(texture) for texture in textures]
    return geometry


def _write_ply(
    path: Path,
    mesh: o3d.geometry.TriangleMesh,
    support: NDArray[np.int64] | None,
    uncertainty: NDArray[np.float64] | None,
) -> bool:
    """Write as Open3D does, binary, in double precision; it would leave out support and uncertainty."""
    columns: list[tuple[str, str, NDArray[Any]]] = []  # name, type in PLY, values

    def add(names: str, kind: str, values: NDArray[Any]) -> None:
        columns.extend((name, kind, values[:, n]) for n, name in enumerate(names.split()))

    add("x y z", "double", np.asarray(mesh.vertices))
    if mesh.has_vertex_normals():
        add("nx ny nz", "double", np.asarray(mesh.vertex_normals))
    if mesh.has_vertex_colors():
        add("red green blue", "uchar", _eight_bits(mesh.vertex_colors))
    if support is not None:
        add("support", "int", support[:, None])
    if uncertainty is not None:
        add("uncertainty", "float", uncertainty[:, None])
    vertices = np.empty(len(mesh.vertices), [(name, _PLY_TYPES[kind]) for name, kind, _ in columns])
    for name, _, values in columns:
        vertices[name] = values
    faces = np.empty(len(mesh.triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, np.asarray(mesh.triangles)
    properties = "".join(f"property {kind} {name}\n" for name, kind, _ in columns)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode("ascii") + vertices.tobytes() + faces.tobytes())
    return len(vertices) > 0


def _eight_bits(colors: o3d.utility.Vector3dVector) -> NDArray[np.uint8]:
    """(n, 3) colours, 0 to 255."""
    return np.asarray(np.rint(255 * np.clip(np.asarray(colors), 0, 1)), np.uint8)


def _to_trimesh(mesh: o3d.geometry.TriangleMesh) -> trimesh.Trimesh:
    """The same mesh, vertex by vertex, with 8-bit colours."""
    import trimesh

    return trimesh.Trimesh(
        np.asarray(mesh.vertices),
        np.asarray(mesh.triangles),
        vertex_normals=np.asarray(mesh.vertex_normals) if mesh.has_vertex_normals() else None,
        vertex_colors=_eight_bits(mesh.vertex_colors) if mesh.has_vertex_colors() else None,
        process=False,
    )
