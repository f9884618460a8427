"""Meshes, clouds and voxel grids out of files, checked: on damaged ones Open3D's own readers end the process."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import DataError
from recon3d.io.geometry import Geometry

_PLY_ELEMENT = re.compile(rb"^\s*element\s+\S+\s+(\d+)", re.MULTILINE)

_GLTF_COUNT = re.compile(rb'"count"\s*:\s*(\d+)')

_MOST_VERTICES = 2**31 - 1  # that a triangle of Open3D can name


def read_geometry(path: Path | str) -> Geometry:
    """Read a mesh (PLY, OBJ, STL, GLB, OFF), a point cloud or a voxel grid (PLY); what a PLY holds says which it is.

    Polygons are cut into triangles; textures are left out.

    Raises
    ------
    DataError : missing, unreadable, empty, or with numbers that are no places or name no vertices.
    """
    path = Path(path)
    content = _content(path)
    if path.suffix.lower() != ".ply":
        return _mesh_of(path, _by_trimesh(path, content))
    found, elements = _by_ply(path, content)
    if "voxel_size" in elements:
        return _voxel_grid_of(path, found, elements)
    if found.get("faces") is not None and len(found["faces"]):
        return _mesh_of(path, found)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(_places(path, found)))
    if (normals := found.get("vertex_normals")) is not None:
        cloud.normals = o3d.utility.Vector3dVector(np.asarray(normals, np.float64))
    if (colors := _colors(found.get("vertex_colors"))) is not None:
        cloud.colors = o3d.utility.Vector3dVector(colors)
    return cloud


def read_mesh(path: Path | str) -> o3d.geometry.TriangleMesh:
    """Read a triangle mesh.

    Raises
    ------
    DataError : as ``read_geometry``, or not a mesh.
    """
    geometry = read_geometry(path)
    if not isinstance(geometry, o3d.geometry.TriangleMesh):
        raise DataError(f"{path}: expected a triangle mesh, got a {type(geometry).__name__}")
    return geometry


def read_support(path: Path | str) -> NDArray[np.int64] | None:
    """(n_vertices,) how many views see each vertex of a mesh that was written as PLY; None where the file has none.

    Raises
    ------
    DataError : missing or unreadable.
    """
    values = _vertex_property(Path(path), "support")
    return None if values is None else values.astype(np.int64)


def read_uncertainty(path: Path | str) -> NDArray[np.float64] | None:
    """(n_vertices,) predicted distance of each vertex of a mesh to the true surface, as ``write_geometry`` wrote it.

    World units; infinite where the surface was filled. None where the file has none.

    Raises
    ------
    DataError : missing or unreadable.
    """
    values = _vertex_property(Path(path), "uncertainty")
    return None if values is None else values.astype(np.float64)


def _vertex_property(path: Path, name: str) -> NDArray[Any] | None:
    """(n_vertices,) a further property of a PLY's vertices; None where it has none, or the file is no PLY."""
    content = _content(path)
    if path.suffix.lower() != ".ply":
        return None
    found, elements = _by_ply(path, content)
    vertices = elements["vertex"]["data"]
    if name not in elements["vertex"]["properties"]:
        return None
    values = np.asarray(vertices[name]).ravel()
    if values.shape != (len(_places(path, found)),) or not np.issubdtype(values.dtype, np.number):
        raise DataError(f"{path}: expected a number {name} for each vertex")
    return values


def _content(path: Path) -> bytes:
    """What the file holds, unless it says of itself that it holds more than it does."""
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    content = path.read_bytes()
    counts = {".ply": _PLY_ELEMENT, ".glb": _GLTF_COUNT}.get(path.suffix.lower())
    # A header of gigabytes: no element takes less than a byte.
    head = content.partition(b"end_header")[0] if counts is _PLY_ELEMENT else content
    for count in counts.findall(head) if counts else ():
        if len(count) > 18 or int(count) > len(content):
            raise DataError(f"{path}: says that it holds {count.decode()[:30]} elements in {len(content)} bytes")
    return content


def _by_ply(path: Path, content: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """What trimesh finds in a PLY, and the elements as the file names them."""
    from trimesh.exchange.ply import load_ply  # half a second
    from trimesh.geometry import triangulate_quads

    try:
        found: dict[str, Any] = load_ply(BytesIO(content), fix_texture=False, skip_materials=True)
        if np.shape(found.get("faces", ()))[1:] != (3,):
            found["faces"] = triangulate_quads(found.get("faces", ()))
        elements: dict[str, Any] = found["metadata"]["_ply_raw"]
        if "vertices" not in found or "data" not in elements["vertex"]:
            raise ValueError("no vertices")
        for name in ("vertices", "vertex_normals", "vertex_colors"):
            found[name] = None if found.get(name) is None else np.asarray(found[name])
        found["vertices"] = found["vertices"].astype(np.float64)
    except Exception as error:  # whatever a damaged file leads to
        raise _unreadable(path, error) from None
    return found, elements


def _by_trimesh(path: Path, content: bytes) -> dict[str, Any]:
    """What trimesh finds in any other mesh, without the files that this may name."""
    import trimesh

    try:
        kind = path.suffix[1:].lower()
        mesh = trimesh.load_mesh(BytesIO(content), file_type=kind, process=False, skip_materials=True)
        visual = mesh.visual
        return {
            "vertices": mesh.vertices,
            "faces": mesh.faces,
            "vertex_normals": mesh.vertex_normals if "vertex_normals" in mesh._cache else None,
            "vertex_colors": visual.vertex_colors if visual.kind == "vertex" else None,
        }
    except Exception as error:  # whatever a damaged file leads to
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> DataError:
    reason = f"{error}".splitlines()[0][:120] if f"{error}" else type(error).__name__
    return DataError(f"{path}: expected a mesh, point cloud or voxel grid, got a file that cannot be read: {reason}")


def _mesh_of(path: Path, found: dict[str, Any]) -> o3d.geometry.TriangleMesh:
    """Open3D's mesh of vertices and faces that were checked."""
    vertices, faces = _places(path, found), np.asarray(found["faces"])
    if not len(faces):
        raise DataError(f"{path}: expected a mesh, point cloud or voxel grid, got a mesh without triangles")
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise DataError(f"{path}: expected triangles of three vertices")
    wrong = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise DataError(
            f"{path}: triangle {first} names vertices {', '.join(map(str, faces[first].tolist()))}; "
            f"expected 0 to {len(vertices) - 1}"
        )
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    normals = found.get("vertex_normals")
    if normals is not None and np.shape(normals) == vertices.shape:
        mesh.vertex_normals = o3d.utility.Vector3dVector(np.asarray(normals, np.float64))
    colors = _colors(found.get("vertex_colors"))
    if colors is not None and len(colors) == len(vertices):
        mesh.vertex_colors = o3d.utility.Vector3dVector(colors)
    return mesh


def _places(path: Path, found: dict[str, Any]) -> NDArray[np.float64]:
    """(n, 3) vertices, of which there is one or more, all finite."""
    vertices = np.asarray(found["vertices"], np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not 0 < len(vertices) <= _MOST_VERTICES:
        raise DataError(f"{path}: expected a mesh, point cloud or voxel grid, got one without vertices")
    wrong = ~np.isfinite(vertices).all(axis=1)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise DataError(f"{path}: vertex {first} lies at {vertices[first].tolist()}, which is no place")
    return np.ascontiguousarray(vertices)


def _colors(values: object) -> NDArray[np.float64] | None:
    """(n, 3) RGB in [0, 1] of whole numbers of 8 or 16 bits or of fractions; None of none."""
    colors = np.asarray(values)
    if values is None or colors.ndim != 2 or colors.shape[1] < 3:
        return None
    largest = np.iinfo(colors.dtype).max if np.issubdtype(colors.dtype, np.integer) else 1
    return np.clip(np.nan_to_num(colors[:, :3].astype(np.float64) / largest), 0, 1)


def _voxel_grid_of(path: Path, found: dict[str, Any], elements: dict[str, Any]) -> o3d.geometry.VoxelGrid:
    """Open3D's grid as it writes it: the vertices are the voxels' indices."""
    try:
        origin, rotation, (size,) = (
            np.array([float(np.ravel(elements[name]["data"][each])[0]) for each in elements[name]["properties"]])
            for name in ("origin", "rotation", "voxel_size")
        )
        if origin.shape != (3,) or not np.array_equal(rotation, np.eye(3).ravel()):
            raise ValueError("it is turned against the axes")
        if not (np.isfinite(origin).all() and 0 < size < np.inf):
            raise ValueError(f"voxels of {size:g} from {origin.tolist()}")
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise _unreadable(path, error) from None
    voxels = np.rint(_places(path, found))
    if np.abs(voxels).max() > np.iinfo(np.int32).max / 2:
        raise _unreadable(path, ValueError(f"a voxel of index {np.abs(voxels).max():g}"))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(origin + size * (voxels + 0.5)))
    if (colors := _colors(found.get("vertex_colors"))) is not None:
        cloud.colors = o3d.utility.Vector3dVector(colors)
    # Only this constructor keeps the origin; it wants an upper bound beyond the last voxel.
    return o3d.geometry.VoxelGrid.create_from_point_cloud_within_bounds(
        cloud, size, origin, origin + size * (voxels.max(axis=0) + 1)
    )
