"""Quality without a ground truth: against known shapes, known photographs, Open3D and slow twins."""

import json
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh, cameras, photographs

import recon3d
from recon3d.datasets import BuiltInScene
from recon3d.evaluation.photographs import Reprojection, measure_quality
from recon3d.evaluation.shape import ShapeQuality
from recon3d.rendering import Renderer
from recon3d.scene import without_silhouettes
from recon3d.surface import mesh_volume


def without(mesh: o3d.geometry.TriangleMesh, removed: list[int]) -> o3d.geometry.TriangleMesh:
    """The mesh without some triangles."""
    mask = np.zeros(len(mesh.triangles), np.bool_)
    mask[removed] = True
    part = o3d.geometry.TriangleMesh(mesh)
    part.remove_triangles_by_mask(mask)
    return part


def test_a_box_is_one_closed_piece_with_twelve_right_angles() -> None:
    shape = ShapeQuality.of(box_mesh(1, 2, 3))
    diagonals = 2 * (np.hypot(1, 2) + np.hypot(2, 3) + np.hypot(1, 3))
    assert shape.dihedral_degrees == pytest.approx(90 * 24 / (24 + diagonals))
    assert replace(shape, dihedral_degrees=0) == ShapeQuality(1, 0, 0, 0, 0, 0, 0)


def test_handles_of_all_closed_pieces_count() -> None:
    torus = o3d.geometry.TriangleMesh.create_torus()
    assert ShapeQuality.of(torus).genus == 1
    pair = torus + o3d.geometry.TriangleMesh(torus).translate((5, 0, 0)) + ball_mesh(0.1)
    assert ShapeQuality.of(pair).genus == 2
    assert ShapeQuality.of(without(pair, [0])).genus == 1  # an open piece has no genus
    assert ShapeQuality.of(without(torus, [0])).genus is None


def test_all_but_the_largest_piece_float() -> None:
    shape = ShapeQuality.of(box_mesh(1, 1, 1) + box_mesh(2, 2, 2).translate((5, 0, 0)) + box_mesh(1, 1, 1))
    assert shape.components == 3  # two lie in one place, but share no vertex
    assert shape.floating_share == pytest.approx(12 / 36)


def test_holes_are_counted_and_are_one_where_they_touch() -> None:
    ball = ball_mesh(1.0, 12)
    triangles = np.asarray(ball.triangles)
    vertex = int(triangles[200, 0])
    around = np.flatnonzero((triangles == vertex).any(axis=1))
    shared = [len(np.intersect1d(triangles[around[0]], triangles[other])) for other in around]
    opposite = int(around[shared.index(1)])
    shape = ShapeQuality.of(without(ball, [int(around[0]), opposite]))
    assert (shape.components, shape.boundary_loops, shape.nonmanifold_vertices) == (1, 1, 1)
    far = int(np.flatnonzero(~np.isin(triangles, triangles[around]).any(axis=1))[0])
    assert ShapeQuality.of(without(ball, [int(around[0]), far])).boundary_loops == 2


def test_pieces_that_touch_in_a_vertex_or_a_crowded_edge_are_told() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], float)
    solid = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mirrored = np.where(solid > 0, solid + 3, 0)[:, ::-1]
    touching = ShapeQuality.of(_mesh(points, np.vstack([solid, mirrored])))
    assert (touching.components, touching.nonmanifold_vertices, touching.genus) == (2, 1, 0)
    crowded = ShapeQuality.of(_mesh(points, np.array([[0, 1, 2], [1, 0, 3], [0, 1, 5]])))
    assert (crowded.components, crowded.nonmanifold_edges, crowded.genus) == (1, 1, None)


def _mesh(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> o3d.geometry.TriangleMesh:
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(points), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )


@pytest.mark.parametrize("share", [0.1, 0.4, 0.8])
def test_connectedness_is_what_open3d_finds_on_torn_surfaces(share: float) -> None:
    torn = o3d.geometry.TriangleMesh.create_torus(tubular_resolution=20)
    rng = np.random.default_rng(5)
    torn.remove_triangles_by_mask(rng.random(len(torn.triangles)) < share)
    torn.remove_unreferenced_vertices()
    shape = ShapeQuality.of(torn)
    assert shape.components == len(torn.cluster_connected_triangles()[1])
    assert shape.nonmanifold_vertices == len(torn.get_non_manifold_vertices()) > 0
    assert shape.nonmanifold_edges == len(torn.get_non_manifold_edges(allow_boundary_edges=True)) == 0


def test_a_triangle_without_area_has_no_say_in_the_angles() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0, 0]], float)
    folded = np.array([[0, 1, 2], [1, 0, 3]])
    assert ShapeQuality.of(_mesh(points, folded)).dihedral_degrees == pytest.approx(90)
    flat = np.vstack([folded, [[3, 1, 1]]])  # a sliver beside the fold
    assert ShapeQuality.of(_mesh(points, flat)).dihedral_degrees == pytest.approx(90)
    assert ShapeQuality.of(_mesh(points, folded[:1])).dihedral_degrees == 0


def test_a_mesh_without_triangles_is_refused(temple: BuiltInScene) -> None:
    with pytest.raises(ValueError, match="no triangles"):
        measure_quality(o3d.geometry.TriangleMesh(), temple.scene)
    with pytest.raises(ValueError, match="max_pixels of at least 1, got 0"):
        measure_quality(temple.ground_truth, temple.scene, max_pixels=0)


@pytest.fixture(scope="module")
def striped() -> tuple[o3d.geometry.TriangleMesh, recon3d.Scene]:
    """A ball with colours at its vertices, and photographs that show exactly what it renders to."""
    mesh = ball_mesh(1.0, 20)
    levels = 0.2 + 0.4 * np.random.default_rng(0).random((len(mesh.vertices), 3))
    mesh.vertex_colors = o3d.utility.Vector3dVector(levels)
    scene, renderer = photographs(mesh, taken_by=cameras(3)), Renderer(mesh)
    views = []
    for view in scene.views:
        rendering = renderer.render_view(view)
        image = np.rint(255 * rendering.colors).astype(np.uint8)
        views.append(replace(view, photograph=image, mask=rendering.hit))
    return mesh, replace(scene, views=tuple(views))


def test_a_mesh_that_the_photographs_show_has_no_error(
    striped: tuple[o3d.geometry.TriangleMesh, recon3d.Scene],
) -> None:
    quality = measure_quality(*striped)
    assert quality.overall.overlap == 1
    assert quality.overall.rms is not None
    assert quality.overall.rms < 0.5  # rounding to whole grey levels
    assert quality.overall.pixels == sum(view.silhouette.sum() for view in striped[1].views)  # type: ignore[union-attr]
    json.dumps(quality.record(), allow_nan=False)


def test_an_error_that_few_pixels_have_moves_the_mean_and_not_the_median(
    striped: tuple[o3d.geometry.TriangleMesh, recon3d.Scene],
) -> None:
    mesh, scene = striped
    first = scene.views[0]
    image = first.image + np.uint8(10)
    image[:14] += np.uint8(40)
    found = measure_quality(mesh, replace(scene, views=(replace(first, photograph=image),))).views[first.name]
    assert first.silhouette is not None
    share = first.silhouette[:14].sum() / first.silhouette.sum()
    assert 0 < share < 0.5
    assert found.median == pytest.approx(10, abs=0.5)  # rounding
    assert found.mean == pytest.approx(10 + 40 * share, abs=0.1)
    assert found.rms == pytest.approx(np.sqrt(share * 50**2 + (1 - share) * 10**2), abs=0.2)


def test_larger_photographs_are_sampled_at_pixels_as_they_are(temple: BuiltInScene) -> None:
    mesh = mesh_volume(recon3d.VisualHull().carve(temple.scene, _volume(temple.scene)).volume)
    view, renderer = temple.scene.views[2], Renderer(mesh)
    rendering = renderer.render_view(view)
    assert view.silhouette is not None
    for pixels, taken in (
        (10**9, np.s_[:, :]),
        (160 * 120 // 9 + 1, np.s_[1::3, 1::3]),
        (160 * 120 // 4, np.s_[::2, ::2]),
    ):
        hit, silhouette = rendering.hit[taken], view.silhouette[taken]
        both = hit & silhouette
        luminance = [colors @ [0.299, 0.587, 0.114] for colors in (255 * rendering.colors[taken], view.image[taken])]
        difference = np.abs(luminance[0] - luminance[1])[both]
        found = measure_quality(mesh, temple.scene.subset([view.name]), max_pixels=pixels).overall
        assert found.pixels == len(difference) > 0
        assert found.mean == pytest.approx(difference.mean(), abs=0.05)
        assert found.median == pytest.approx(np.median(difference), abs=0.2)
        assert found.rms == pytest.approx(np.sqrt((difference**2).mean()), abs=0.05)
        assert found.overlap == both.sum() / (hit | silhouette).sum()


def _volume(scene: recon3d.Scene) -> recon3d.CarvingVolume:
    return recon3d.CarvingVolume.enclosing(scene.bounds, n_voxels=30_000)


def test_all_views_together_weigh_every_pixel_the_same() -> None:
    few, many = np.zeros((2, 2551), np.int64)
    few[100], many[200] = 1, 3
    together = recon3d.Quality(
        {"a": Reprojection(few, 1, 2), "b": Reprojection(many, 4, 4)}, ShapeQuality.of(box_mesh(1, 1, 1))
    ).overall
    assert (together.pixels, together.mean, together.median, together.overlap) == (4, 17.5, 20, 5 / 6)


def test_what_is_not_known_is_none(striped: tuple[o3d.geometry.TriangleMesh, recon3d.Scene]) -> None:
    mesh, scene = striped
    bare = without_silhouettes(scene)
    assert measure_quality(mesh, bare).overall.overlap is None
    colourless = measure_quality(ball_mesh(), scene)
    assert colourless.overall.median is colourless.overall.mean is colourless.overall.rms is None
    assert colourless.overall.overlap == pytest.approx(1, abs=0.05)
    assert "not coloured" in repr(colourless)
