"""Damaged meshes, clouds and voxel grids: an error that names the file, or geometry that can be measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scenes import ball_mesh, ball_volume

from recon3d.errors import DataError
from recon3d.evaluation import evaluate
from recon3d.io.geometry import write_geometry
from recon3d.io.reading_geometry import read_geometry, read_support

ASCII = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property int support
element face 2
property list uchar int vertex_indices
end_header
0 0 0 0
1 0 0 1
1 1 0 2
0 1 0 3
3 0 1 2
3 0 2 3
"""

TOKENS = [b"0", b"-1", b"nan", b"inf", b"1e999", b"1000000000", b"999999999999999999999", b"\xff\xfe", b"", b"element"]


def written(folder: Path, kind: str) -> bytes:
    """A whole file of a kind."""
    mesh = ball_mesh(1.0, 5)
    mesh.compute_vertex_normals()
    mesh.paint_uniform_color([0.2, 0.4, 0.6])
    if kind == "ascii.ply":
        return ASCII.encode()
    shapes = {
        "cloud.ply": o3d.geometry.PointCloud(mesh.vertices),
        "voxels.ply": ball_volume(8).to_voxel_grid(),
    }
    support = np.arange(len(mesh.vertices)) if kind == "mesh.ply" else None
    return write_geometry(folder / f"whole-{kind}", shapes.get(kind, mesh), support=support).read_bytes()


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """The content with a few bytes, a token, a line or a stretch of it changed, most often near its beginning."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        at = int(len(data) * rng.random() ** rng.choice([1, 4])) if data else 0
        match rng.integers(5):
            case 0:
                data[at : at + 1] = rng.bytes(1)
            case 1:
                end = data.find(b" ", at) % (len(data) + 1)
                data[at:end] = rng.choice(np.array(TOKENS, object))
            case 2:
                del data[at : at + int(rng.integers(1, 200))]
            case 3:
                data[at:at] = data[at // 2 : at // 2 + int(rng.integers(1, 200))]
            case _:
                data[at : at + 4] = np.array(rng.choice([-1, 10**6, 2**31 - 1, 0]), np.int32).tobytes()
    return bytes(data)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["mesh.ply", "ascii.ply", "cloud.ply", "voxels.ply", "a.obj", "a.stl", "a.glb"])
def test_a_damaged_file_is_refused_or_can_be_measured(tmp_path: Path, kind: str) -> None:
    content, rng, truth = written(tmp_path, kind), np.random.default_rng(len(kind)), ball_mesh(1.0, 3)
    path, refused = tmp_path / f"damaged-{kind}", 0
    for _ in range(150):
        path.write_bytes(damaged(content, rng))
        try:
            shape = read_geometry(path)
        except DataError as error:
            assert path.name in str(error)  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017
            refused += 1
            continue
        if isinstance(shape, o3d.geometry.VoxelGrid):
            assert shape.has_voxels()
        elif abs(np.concatenate([shape.get_min_bound(), shape.get_max_bound()])).max() < 10:
            assert np.isfinite(evaluate(shape, truth, spacing=0.2).accuracy_distances).all()
    assert 0 < refused < 150


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("3 0 2 3", "3 0 2 1000000"), "triangle 1 names vertices 0, 2, 1000000; expected 0"),
        (lambda text: text.replace("3 0 2 3", "3 0 2 -1"), "triangle 1 names vertices 0, 2, -1; expected 0 to 3"),
        (lambda text: text.replace("1 1 0 2", "nan 1 0 2"), r"vertex 2 lies at \[nan, 1.0, 0.0\], which is no place"),
        (lambda text: text.replace("vertex 4", "vertex 1000000000"), "says that it holds 1000000000 elements in"),
        (lambda text: text.replace("face 2", f"face {'9' * 400}"), "says that it holds 999"),
        (lambda _: "ply\n", "expected a mesh, point cloud or voxel grid, got a file that cannot be read"),
        (lambda _: "", "expected a mesh, point cloud or voxel grid, got a file that cannot be read"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(tmp_path: Path, change: Callable[[str], str], message: str) -> None:
    (tmp_path / "a.ply").write_text(change(ASCII))
    with pytest.raises(DataError, match=rf"a\.ply: {message}"):
        read_geometry(tmp_path / "a.ply")


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("comments", [0, 70, 5000])
def test_headers_of_any_length_and_line_ending_are_read(tmp_path: Path, comments: int, ending: str) -> None:
    lines = ASCII.splitlines()
    lines[2:2] = [f"comment {'element face 3 ' * 5}"] * comments
    (tmp_path / "a.ply").write_bytes((ending.join(lines) + ending).encode())
    mesh = read_geometry(tmp_path / "a.ply")
    assert isinstance(mesh, o3d.geometry.TriangleMesh)
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(read_support(tmp_path / "a.ply"), [0, 1, 2, 3])


def test_faces_of_four_corners_are_cut_and_none_makes_a_cloud(tmp_path: Path) -> None:
    square = ASCII.replace("face 2", "face 1").replace("3 0 1 2\n3 0 2 3\n", "4 0 1 2 3\n")
    (tmp_path / "square.ply").write_text(square)
    mesh = read_geometry(tmp_path / "square.ply")
    assert isinstance(mesh, o3d.geometry.TriangleMesh)
    assert mesh.get_surface_area() == pytest.approx(1)
    (tmp_path / "points.ply").write_text(ASCII.replace("face 2", "face 0").partition("3 0 1 2")[0])
    cloud = read_geometry(tmp_path / "points.ply")
    assert isinstance(cloud, o3d.geometry.PointCloud)
    assert len(cloud.points) == 4
