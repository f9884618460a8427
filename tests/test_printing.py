"""Meshes for printers, read back as slicers do."""

from __future__ import annotations

import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scenes import ball_mesh, box_mesh, edge_counts, signed_volume

from recon3d.errors import OpenMeshError
from recon3d.io.printing import is_closed, write_print
from recon3d.io.reading_geometry import read_mesh


def read_print(path: Path) -> o3d.geometry.TriangleMesh:
    """A mesh as a slicer reads it: of a 3MF, that which the package's relationships lead to."""
    if path.suffix == ".stl":
        return read_mesh(path).merge_close_vertices(1e-6)
    with zipfile.ZipFile(path) as package:
        assert package.testzip() is None
        (start,) = ET.fromstring(package.read("_rels/.rels"))  # noqa: S314 (written here)
        model = ET.fromstring(package.read(start.attrib["Target"].lstrip("/")))  # noqa: S314
        (content,) = [name for name in package.namelist() if name == "[Content_Types].xml"]
        kinds = {each.attrib["Extension"] for each in ET.fromstring(package.read(content))}  # noqa: S314
    assert kinds == {"rels", "model"}
    assert model.attrib["unit"] == "millimeter"
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    (shape,) = model.iter(f"{core}object")
    assert [item.attrib["objectid"] for item in model.iter(f"{core}item")] == [shape.attrib["id"]]
    points = [[float(each.attrib[axis]) for axis in "xyz"] for each in shape.iter(f"{core}vertex")]
    corners = [[int(each.attrib[name]) for name in ("v1", "v2", "v3")] for each in shape.iter(f"{core}triangle")]
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(points)), o3d.utility.Vector3iVector(np.array(corners, np.int32))
    )


@pytest.mark.parametrize("suffix", [".3mf", ".stl"])
def test_a_print_has_millimetres_and_stands_on_the_plate(tmp_path: Path, suffix: str) -> None:
    box = box_mesh(0.02, 0.03, 0.05).translate((4.0, -7.0, 0.3))
    print_from_world = np.diag([1000.0, 1000, 1000, 1])
    print_from_world[:3, :3] = print_from_world[:3, :3] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # the world's y is up
    found = read_print(write_print(tmp_path / f"box{suffix}", box, print_from_world))
    np.testing.assert_allclose(found.get_min_bound(), [-10, -25, 0], atol=1e-3)
    np.testing.assert_allclose(found.get_max_bound(), [10, 25, 30], atol=1e-3)
    assert signed_volume(found) == pytest.approx(20 * 50 * 30, rel=1e-4)
    assert (edge_counts(found) == 2).all()
    assert [path.name for path in tmp_path.iterdir()] == [f"box{suffix}"]


def test_an_open_mesh_is_refused_and_leaves_no_file(tmp_path: Path) -> None:
    ball = ball_mesh()
    ball.triangles = o3d.utility.Vector3iVector(np.asarray(ball.triangles)[1:])
    with pytest.raises(OpenMeshError, match=r"a\.3mf: expected a closed mesh to print.*--keep-unsupported"):
        write_print(tmp_path / "a.3mf", ball)
    assert not list(tmp_path.iterdir())


def test_closed_is_what_bounds_a_solid() -> None:
    ball = ball_mesh()
    assert is_closed(ball)
    assert is_closed(ball + ball_mesh().translate((5, 0, 0)))
    triangles = np.asarray(ball.triangles)
    for wrong in (
        triangles[:0],
        triangles[1:],
        np.vstack([triangles[:1, ::-1], triangles[1:]]),  # one faces inwards
        np.vstack([triangles, triangles]),
    ):
        assert not is_closed(o3d.geometry.TriangleMesh(ball.vertices, o3d.utility.Vector3iVector(wrong)))
