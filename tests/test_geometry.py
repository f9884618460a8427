from __future__ import annotations

import json
import os
import pickle
import stat
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest
from scenes import ball_mesh, ball_volume

from recon3d.errors import DataError
from recon3d.io.files import atomic_path, write_image, write_json, write_text
from recon3d.io.geometry import MESH_SUFFIXES, from_arrays, geometry_arrays, write_geometry
from recon3d.io.reading_geometry import read_geometry, read_mesh, read_support, read_uncertainty
from recon3d.scene.image_file import read_image


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_appears_when_the_block_ends_well(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "folder" / "a.txt"
    with atomic_path(target) as temporary:
        temporary.write_text("new")
        assert not target.exists()
        assert temporary.suffix == ".txt"
        assert temporary.parent == target.parent
    assert target.read_text() == "new"
    assert names(target.parent) == ["a.txt"]


class Interruption(BaseException):
    """What a user's interrupt would be."""


@pytest.mark.parametrize("kind", [RuntimeError, Interruption])
def test_a_write_that_fails_leaves_the_old_file_and_no_temporary(tmp_path: Path, kind: type[BaseException]) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise kind

    with pytest.raises(kind):
        write()
    assert target.read_text() == "old"
    assert names(tmp_path) == ["a.txt"]


def test_open3ds_failure_leaves_the_old_file_and_no_temporary(tmp_path: Path) -> None:
    target = tmp_path / "a.ply"
    write_geometry(target, ball_mesh())
    before = target.read_bytes()
    with pytest.raises(OSError, match=r"a\.ply: Open3D could not write the PointCloud"):
        write_geometry(target, o3d.geometry.PointCloud())
    assert target.read_bytes() == before
    assert names(tmp_path) == ["a.ply"]


def test_files_are_as_readable_as_the_user_wants_them(tmp_path: Path) -> None:
    old = os.umask(0o027)
    try:
        write_text(tmp_path / "a.txt", "x")
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


def colored_mesh() -> o3d.geometry.TriangleMesh:
    mesh = ball_mesh(1.0, 6)
    mesh.compute_vertex_normals()
    grey = np.linspace(0, 1, len(mesh.vertices))
    mesh.vertex_colors = o3d.utility.Vector3dVector(np.column_stack([grey, 1 - grey, 0 * grey]))
    return mesh


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_a_mesh_reads_back_in_every_format(tmp_path: Path, suffix: str) -> None:
    mesh = colored_mesh()
    path = write_geometry(tmp_path / f"mesh{suffix}", mesh)
    assert path == tmp_path / f"mesh{suffix}"
    read = read_mesh(path)
    assert len(read.triangles) == len(mesh.triangles)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    read_corners = np.asarray(read.vertices)[np.asarray(read.triangles)]
    # OBJ is text of six digits, GLB and STL are single precision.
    np.testing.assert_allclose(read_corners, corners, atol=2e-6)
    if suffix in (".ply", ".obj", ".glb"):
        assert read.has_vertex_colors()
        colors = np.asarray(mesh.vertex_colors)[np.asarray(mesh.triangles)]
        # PLY holds eight bits a channel.
        np.testing.assert_allclose(np.asarray(read.vertex_colors)[np.asarray(read.triangles)], colors, atol=1 / 255)


@pytest.mark.parametrize("with_colors", [True, False])
def test_a_ply_file_keeps_the_support_of_every_vertex(tmp_path: Path, with_colors: bool) -> None:
    mesh = colored_mesh() if with_colors else ball_mesh()
    support = np.arange(len(mesh.vertices)) % 17
    path = write_geometry(tmp_path / "a.ply", mesh, support=support)
    np.testing.assert_array_equal(read_support(path), support)
    read = read_mesh(path)
    np.testing.assert_array_equal(np.asarray(read.vertices), np.asarray(mesh.vertices))
    np.testing.assert_array_equal(np.asarray(read.triangles), np.asarray(mesh.triangles))
    np.testing.assert_array_equal(np.asarray(read.vertex_normals), np.asarray(mesh.vertex_normals))
    assert read.has_vertex_colors() == with_colors


def test_open3d_writes_the_same_mesh_as_we_do(tmp_path: Path) -> None:
    mesh = colored_mesh()
    o3d.io.write_triangle_mesh(tmp_path / "theirs.ply", mesh)
    ours, theirs = read_mesh(write_geometry(tmp_path / "ours.ply", mesh)), read_mesh(tmp_path / "theirs.ply")
    for part in ("vertices", "triangles", "vertex_normals"):
        np.testing.assert_array_equal(np.asarray(getattr(ours, part)), np.asarray(getattr(theirs, part)))
    # One rounds, the other cuts off.
    np.testing.assert_allclose(np.asarray(ours.vertex_colors), np.asarray(theirs.vertex_colors), atol=1.01 / 255)


def test_a_file_without_support_has_none(tmp_path: Path) -> None:
    assert read_support(write_geometry(tmp_path / "a.ply", ball_mesh())) is None
    assert read_support(write_geometry(tmp_path / "a.obj", ball_mesh())) is None
    with pytest.raises(DataError, match=r"b\.ply: no such file"):
        read_support(tmp_path / "b.ply")


def test_support_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"expected a number for each vertex of a mesh as support, got shape \(3,\)"):
        write_geometry(tmp_path / "a.ply", ball_mesh(), support=np.zeros(3, np.int64))
    path = write_geometry(tmp_path / "b.ply", ball_mesh(), support=np.zeros(len(ball_mesh().vertices), np.int64))
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(DataError, match=r"b\.ply: says that it holds \d+ elements in 500 bytes"):
        read_support(path)
    path.write_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty int support\nend_header\n3\n")
    with pytest.raises(DataError, match="got a file that cannot be read"):
        read_support(path)


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_writing_a_mesh_leaves_no_other_file(tmp_path: Path, suffix: str) -> None:
    write_geometry(tmp_path / f"mesh{suffix}", colored_mesh())
    assert names(tmp_path) == [f"mesh{suffix}"]
    if suffix in (".ply", ".obj"):
        assert b".mesh-" not in (tmp_path / f"mesh{suffix}").read_bytes()


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_writing_does_not_change_the_mesh(tmp_path: Path, suffix: str) -> None:
    mesh = colored_mesh()
    mesh.triangle_normals = o3d.utility.Vector3dVector()
    write_geometry(tmp_path / f"mesh{suffix}", mesh)
    assert not mesh.has_triangle_normals()


def test_suffixes_are_read_in_capitals_too(tmp_path: Path) -> None:
    assert len(read_mesh(write_geometry(tmp_path / "MESH.PLY", ball_mesh())).triangles) > 0


def test_a_point_cloud_reads_back_with_colours_and_normals(tmp_path: Path) -> None:
    mesh = colored_mesh()
    cloud = o3d.geometry.PointCloud(mesh.vertices)
    cloud.normals, cloud.colors = mesh.vertex_normals, mesh.vertex_colors
    read = read_geometry(write_geometry(tmp_path / "cloud.ply", cloud))
    assert isinstance(read, o3d.geometry.PointCloud)
    np.testing.assert_array_equal(np.asarray(read.points), np.asarray(cloud.points))
    np.testing.assert_array_equal(np.asarray(read.normals), np.asarray(cloud.normals))
    np.testing.assert_allclose(np.asarray(read.colors), np.asarray(cloud.colors), atol=1 / 255)


def test_a_voxel_grid_reads_back_as_one(tmp_path: Path) -> None:
    volume = ball_volume(0.9, 12)
    read = read_geometry(write_geometry(tmp_path / "grid.ply", volume.to_voxel_grid()))
    assert isinstance(read, o3d.geometry.VoxelGrid)
    assert len(read.get_voxels()) == volume.n_occupied


@pytest.mark.parametrize(
    ("geometry", "suffix", "message"),
    [
        (ball_mesh(), ".off", r"a TriangleMesh is written as \.ply, \.obj, \.glb, \.stl"),
        (ball_mesh(), "", "a TriangleMesh is written as"),
        (o3d.geometry.PointCloud(ball_mesh().vertices), ".obj", r"a PointCloud is written as \.ply"),
        (ball_volume(0.9, 6).to_voxel_grid(), ".stl", r"a VoxelGrid is written as \.ply"),
    ],
)
def test_a_format_that_does_not_fit_is_refused(
    tmp_path: Path, geometry: o3d.geometry.Geometry, suffix: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        write_geometry(tmp_path / f"a{suffix}", geometry)
    assert names(tmp_path) == []


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"a\.ply: no such file"):
        read_geometry(tmp_path / "a.ply")
    with pytest.raises(DataError, match=r"a\.png: no such image"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.stl", "a.xyz"])
def test_an_unreadable_geometry_is_an_error(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("nothing of the kind\n")
    with pytest.raises(DataError, match="expected a mesh, point cloud or voxel grid, got "):
        read_geometry(tmp_path / name)


def test_a_point_cloud_is_not_a_mesh(tmp_path: Path) -> None:
    write_geometry(tmp_path / "a.ply", o3d.geometry.PointCloud(ball_mesh().vertices))
    with pytest.raises(DataError, match=r"a\.ply: expected a triangle mesh, got a PointCloud"):
        read_mesh(tmp_path / "a.ply")


def test_an_image_reads_back_in_rgb(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (7, 9, 3), dtype=np.uint8)
    path = write_image(tmp_path / "new" / "a.png", image)
    np.testing.assert_array_equal(read_image(path), image)
    # OpenCV itself reads blue first.
    np.testing.assert_array_equal(cv2.imread(str(path)), image[..., ::-1])


def test_a_mask_is_written_in_black_and_white(tmp_path: Path) -> None:
    mask = np.random.default_rng(0).random((7, 9)) < 0.5
    written = cv2.imread(str(write_image(tmp_path / "a.png", mask)), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(written, np.where(mask, 255, 0))


def test_a_grey_image_reads_back_with_three_channels(tmp_path: Path) -> None:
    grey = np.arange(63, dtype=np.uint8).reshape(7, 9)
    read = read_image(write_image(tmp_path / "a.png", grey))
    np.testing.assert_array_equal(read, np.repeat(grey[..., None], 3, axis=2))


def test_an_unreadable_image_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(DataError, match=r"a\.png: not a readable image"):
        read_image(tmp_path / "a.png")


def test_json_is_written_readably_and_in_utf_8(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.json", {"name": "Dürer", "x": [1, 2.5], "none": None})
    assert json.loads(path.read_text(encoding="utf-8")) == {"name": "Dürer", "x": [1, 2.5], "none": None}
    assert path.read_text().endswith("}\n")


def test_json_refuses_what_json_does_not_know(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("old")
    with pytest.raises(ValueError, match="Out of range float values"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert (tmp_path / "a.json").read_text() == "old"
    assert names(tmp_path) == ["a.json"]


def test_text_is_written_in_utf_8(tmp_path: Path) -> None:
    assert write_text(tmp_path / "a.txt", "µ ≤ 1\n").read_bytes() == "µ ≤ 1\n".encode()


def test_meshes_and_clouds_come_back_from_their_arrays() -> None:
    mesh = o3d.geometry.TriangleMesh.create_box()
    mesh.compute_vertex_normals()
    mesh.paint_uniform_color([0.1, 0.2, 0.3])
    mesh.triangle_uvs = o3d.utility.Vector2dVector(np.random.default_rng(0).random((36, 2)))
    mesh.triangle_material_ids = o3d.utility.IntVector([0] * 12)
    mesh.textures = [o3d.geometry.Image(np.arange(48, dtype=np.uint8).reshape(4, 4, 3))]
    cloud = mesh.sample_points_uniformly(20)
    copies = pickle.loads(pickle.dumps([geometry_arrays(mesh), geometry_arrays(cloud)]))  # noqa: S301
    again = from_arrays(o3d.geometry.TriangleMesh(), copies[0]), from_arrays(o3d.geometry.PointCloud(), copies[1])
    for before, after in zip((mesh, cloud), again, strict=True):
        expected, found = geometry_arrays(before), geometry_arrays(after)
        assert expected.keys() == found.keys()
        for name, array in expected.items():
            np.testing.assert_array_equal(found[name], array)
    assert from_arrays(o3d.geometry.TriangleMesh(), geometry_arrays(o3d.geometry.TriangleMesh())).is_empty()


def test_a_ply_file_keeps_the_uncertainty_of_every_vertex(tmp_path: Path) -> None:
    mesh = ball_mesh()
    uncertainty = np.linspace(0.1, 1, len(mesh.vertices))
    uncertainty[::3] = np.inf
    support = np.arange(len(mesh.vertices))
    path = write_geometry(tmp_path / "a.ply", mesh, support=support, uncertainty=uncertainty)
    np.testing.assert_allclose(read_uncertainty(path), uncertainty, rtol=1e-6)
    np.testing.assert_array_equal(read_support(path), support)
    np.testing.assert_array_equal(np.asarray(read_mesh(path).vertices), np.asarray(mesh.vertices))
    assert read_uncertainty(write_geometry(tmp_path / "b.ply", mesh, support=support)) is None
    with pytest.raises(ValueError, match=r"a number for each vertex of a mesh as uncertainty, got shape \(2,\)"):
        write_geometry(tmp_path / "c.ply", mesh, uncertainty=np.ones(2))
