"""Specks, seams and sides of meshes."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh, edge_counts, signed_volume

from recon3d.surface.repair import Repairs, repair_mesh


def mesh_of(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> o3d.geometry.TriangleMesh:
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(points.astype(float)), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )


def turned(mesh: o3d.geometry.TriangleMesh) -> o3d.geometry.TriangleMesh:
    return mesh_of(np.asarray(mesh.vertices), np.asarray(mesh.triangles)[:, ::-1])


def welded(*meshes: o3d.geometry.TriangleMesh) -> o3d.geometry.TriangleMesh:
    """Meshes whose equal vertices are one."""
    points = np.concatenate([np.asarray(mesh.vertices) for mesh in meshes])
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    triangles = np.concatenate([np.asarray(m.triangles) + start for m, start in zip(meshes, starts, strict=False)])
    unique, index = np.unique(points.round(9), axis=0, return_inverse=True)
    return mesh_of(unique, index.ravel()[triangles])


def tetrahedron(*corners: tuple[float, float, float]) -> o3d.geometry.TriangleMesh:
    mesh = mesh_of(np.array(corners), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    return mesh if signed_volume(mesh) > 0 else turned(mesh)


def test_specks_are_dropped_and_counted() -> None:
    large, small = ball_mesh(1.0), [ball_mesh(0.1, 6).translate((2.0 * n, 3, 0)) for n in range(3)]
    kept, found, _ = repair_mesh(large + small[0] + small[1] + small[2], min_area=0.2)
    assert found == Repairs(small_components=3)
    assert len(kept.vertices) == len(large.vertices)
    assert kept.get_surface_area() == pytest.approx(large.get_surface_area())


def test_a_piece_of_enough_area_stays() -> None:
    both = ball_mesh(1.0) + box_mesh(0.2, 0.2, 0.2).translate((3, 0, 0))
    assert repair_mesh(both, min_area=0.2399).repairs.small_components == 0
    assert repair_mesh(both, min_area=0.2401).repairs.small_components == 1


def test_the_largest_piece_stays_however_small() -> None:
    both = ball_mesh(0.1) + ball_mesh(0.05).translate((1, 0, 0))
    kept, found, _ = repair_mesh(both, min_area=1e9)
    assert found.small_components == 1
    assert len(kept.vertices) == len(ball_mesh(0.1).vertices)


def test_vertices_on_no_triangle_are_no_specks() -> None:
    ball = ball_mesh(1.0)
    loose = mesh_of(np.vstack([np.asarray(ball.vertices), [[5, 5, 5]]]), np.asarray(ball.triangles))
    assert repair_mesh(loose, min_area=0.1).repairs == Repairs()
    inside = np.vstack([[[0.1, 0, 0]], np.asarray(ball.vertices), [[0, 0, 0]]])
    assert repair_mesh(mesh_of(inside, np.asarray(ball.triangles) + 1))[1] == Repairs()


def test_a_sound_mesh_comes_back_as_it_was() -> None:
    mesh = ball_mesh(1.0) + box_mesh(1, 1, 1).translate((3, 0, 0))
    mended, found, _ = repair_mesh(mesh)
    assert found == Repairs()
    assert str(found) == ""
    np.testing.assert_array_equal(np.asarray(mended.vertices), np.asarray(mesh.vertices))
    np.testing.assert_array_equal(np.asarray(mended.triangles), np.asarray(mesh.triangles))


def test_an_edge_of_four_triangles_is_cut_into_two_sheets() -> None:
    # Two tetrahedra that share an edge and nothing else.
    one = tetrahedron((0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 1, 0))
    other = tetrahedron((0, 0, 0), (0, 0, 1), (-1, 0, 0), (-1, -1, 0))
    mesh = welded(one, other)
    assert edge_counts(mesh).max() == 4
    mended, found, _ = repair_mesh(mesh)
    assert found.non_manifold_edges == 1
    assert found.non_manifold_vertices == 2
    assert mended.is_edge_manifold()
    assert mended.is_vertex_manifold()
    assert signed_volume(mended) == pytest.approx(signed_volume(mesh))
    assert repair_mesh(mended)[1] == Repairs()


def test_a_vertex_where_two_sheets_touch_is_doubled_and_keeps_its_colour() -> None:
    one = tetrahedron((0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 1, 0))
    other = tetrahedron((0, 0, 0), (0, 0, -1), (-1, 0, 0), (-1, -1, 0))
    mesh = welded(one, other)
    mesh.vertex_colors = o3d.utility.Vector3dVector(np.asarray(mesh.vertices) / 4 + 0.5)
    mesh.compute_vertex_normals()
    assert not mesh.is_vertex_manifold()
    mended, found, _ = repair_mesh(mesh)
    assert found == Repairs(non_manifold_vertices=1)
    assert mended.is_vertex_manifold()
    assert len(mended.vertices) == len(mesh.vertices) + 1
    assert mended.has_vertex_normals()
    np.testing.assert_allclose(np.asarray(mended.vertex_colors), np.asarray(mended.vertices) / 4 + 0.5)


def test_a_fan_of_open_triangles_that_meet_in_a_point_is_cut() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]])
    mended, found, _ = repair_mesh(mesh_of(points, np.array([[0, 1, 2], [0, 3, 4]])))
    assert found == Repairs(non_manifold_vertices=1)
    assert len(mended.vertices) == 6


def test_pieces_that_face_inwards_are_turned() -> None:
    mesh = turned(ball_mesh(1.0)) + box_mesh(1, 1, 1).translate((3, 0, 0)) + turned(ball_mesh(0.5)).translate((0, 0, 9))
    mesh.compute_vertex_normals()
    mended, found, _ = repair_mesh(mesh)
    assert found == Repairs(inward_pieces=2)
    expected = signed_volume(ball_mesh(1.0)) + signed_volume(ball_mesh(0.5)) + 1
    assert signed_volume(mended) == pytest.approx(expected)
    n = len(ball_mesh(1.0).vertices)
    assert (np.asarray(mended.vertices)[:n] * np.asarray(mended.vertex_normals)[:n]).sum(axis=1).min() > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_cavity_faces_into_itself(seed: int) -> None:
    # A shell, and a ball inside its cavity; each of the three surfaces may come in either sense.
    flips = np.random.default_rng(seed).random(3) < 0.5
    radii = np.array([1.0, 0.7, 0.3])
    pieces = [turned(ball_mesh(r)) if flip else ball_mesh(r) for r, flip in zip(radii, flips, strict=True)]
    far = (100.0, -50.0, 7.0)
    mended, found, _ = repair_mesh((pieces[0] + pieces[1] + pieces[2]).translate(far))
    volumes = [signed_volume(ball_mesh(r)) for r in radii]
    assert signed_volume(mended.translate(np.negative(far))) == pytest.approx(volumes[0] - volumes[1] + volumes[2])
    assert found.inward_pieces == int(flips[0]) + int(not flips[1]) + int(flips[2])


def test_an_open_piece_is_left_as_it_is() -> None:
    half = turned(ball_mesh(1.0))
    half.remove_triangles_by_index(list(range(40)))
    mended, found, _ = repair_mesh(half)
    assert found.inward_pieces == 0
    np.testing.assert_array_equal(np.asarray(mended.triangles), np.asarray(half.triangles))


def test_triangles_that_disagree_which_side_is_out_are_cut_apart() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    mended, found, _ = repair_mesh(mesh_of(points, np.array([[0, 1, 2], [1, 2, 3]])))
    assert found.non_manifold_edges == 1
    assert len(mended.vertices) == 6


def test_what_is_cut_away_leaves_no_small_component() -> None:
    # A strip of four rectangles: without its middle the first and the last are left, and the last is smaller.
    points = np.column_stack([np.repeat([0, 2, 3, 4, 5.0], 2), np.tile([0, 1.0], 5), np.zeros(10)])
    strip = mesh_of(points, np.vstack([np.array([[0, 2, 3], [0, 3, 1]]) + 2 * n for n in range(4)]))
    kept = np.ones(10, np.bool_)
    assert repair_mesh(strip, kept=kept, min_area=1.5).repairs == Repairs()
    kept[[4, 5]] = False
    part, found, source = repair_mesh(strip, kept=kept, min_area=1.5)
    assert found == Repairs(small_components=1)
    assert source.tolist() == [0, 1, 2, 3]
    assert part.get_surface_area() == pytest.approx(2.0)
    with pytest.raises(ValueError, match="expected a mesh with a triangle to keep, got none of 8"):
        repair_mesh(strip, kept=np.zeros(10, np.bool_))


def test_cutting_apart_leaves_no_small_component_either() -> None:
    # Two tetrahedra that touch in a vertex alone are two pieces.
    large = tetrahedron((0, 0, 0), (0, 0, 2), (2, 0, 0), (2, 2, 0))
    small = tetrahedron((0, 0, 0), (0, 0, -1), (-1, 0, 0), (-1, -1, 0))
    part, found, source = repair_mesh(welded(large, small), min_area=5.0)
    assert found == Repairs(small_components=1, non_manifold_vertices=1)
    assert len(source) == len(part.vertices) == 4
    assert signed_volume(part) == pytest.approx(signed_volume(large))


def test_the_counts_are_told_in_one_line() -> None:
    assert (
        str(Repairs(1200, 0, 2, 1))
        == "1,200 small components dropped, 2 non-manifold vertices doubled, 1 pieces turned outwards"
    )
    assert Repairs(small_components=3).record()["small_components"] == 3
    assert Repairs(1, 2, 3, 4) + Repairs(10, 20, 30, 40) == Repairs(11, 22, 33, 44)
