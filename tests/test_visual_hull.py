"""The visual hull, the item buffer, and carving under exact visibility."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from reference import brute_force_items
from scenes import ball_mesh, cameras, photographs
from scipy.spatial import cKDTree

from recon3d.carving.generalized import GeneralizedVoxelColoring
from recon3d.carving.item_buffer import ItemBuffer
from recon3d.carving.start import hull_distance, outline_distance
from recon3d.carving.visual_hull import VisualHull
from recon3d.carving.voxel_coloring import VoxelColoring
from recon3d.consistency.base import Patches, Verdict
from recon3d.consistency.deviation import StandardDeviation
from recon3d.datasets.synthetic import BuiltInScene, little_temple
from recon3d.errors import EmptyReconstructionError, SceneError
from recon3d.evaluation.distances import distance_to_mesh
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.scene.view import View
from recon3d.surface.extraction import mesh_volume
from recon3d.surface.repair import repair_mesh
from recon3d.surface.visibility import VertexVisibility
from recon3d.volume.carved import Label
from recon3d.volume.dense import CarvingVolume


@pytest.fixture(scope="module")
def ball() -> Scene:
    return photographs(ball_mesh(), taken_by=cameras(12, arc=360.0, width=96, height=72), supersampling=2)


def volume_of(scene: Scene, n_voxels: int) -> CarvingVolume:
    return CarvingVolume.enclosing(scene.bounds, n_voxels=n_voxels)


def test_the_outline_lies_half_a_pixel_beside_the_pixels() -> None:
    mask = np.zeros((40, 40), np.bool_)
    mask[:, :20] = True
    distance = outline_distance(mask)
    np.testing.assert_allclose(distance[20, 15:25], 19.5 - np.arange(15, 25), atol=1e-3)


def test_an_outline_at_the_image_border_says_nothing_of_what_lies_beyond() -> None:
    assert (outline_distance(np.ones((8, 9), np.bool_)) > 0).all()
    assert (outline_distance(np.zeros((8, 9), np.bool_)) < 0).all()


def test_the_visual_hull_holds_the_object(temple: BuiltInScene) -> None:
    volume = volume_of(temple.scene, 100_000)
    field = hull_distance(temple.scene, volume)
    # Silhouettes hold every pixel that shows any of the object, and are blurred by a pixel: at most that is cut off.
    points = np.asarray(temple.ground_truth.sample_points_uniformly(5000).points)
    index = tuple(np.clip(((points - volume.origin) / volume.voxel_size).astype(int), 0, np.array(volume.shape) - 1).T)
    slack = volume.voxel_size * np.sqrt(3) / 2 + temple.scene.pixel_footprint
    assert field[index].min() > -slack


def test_more_views_leave_less(temple: BuiltInScene) -> None:
    scene = temple.scene
    volume = volume_of(scene, 50_000)
    few = VisualHull().carve(replace(scene, views=scene.views[:3]), volume).with_interior.occupied
    more = VisualHull().carve(scene, volume).with_interior.occupied
    assert (more <= few).all()
    assert more.sum() < few.sum()


def test_the_hull_of_a_ball_is_round_to_a_fraction_of_a_voxel(ball: Scene) -> None:
    volume = volume_of(ball, 30_000)
    hull = VisualHull().carve(ball, volume)
    mesh = mesh_volume(hull.with_interior, distance=hull.distance, smoothing=0)
    blocky = mesh_volume(hull.with_interior, smoothing=0)
    seen = [
        np.linalg.norm(np.asarray(m.vertices), axis=1)[VertexVisibility.of(m, ball).n_views >= 3]
        for m in (mesh, blocky)
    ]
    # The hull of twelve cones is itself not quite a ball.
    assert seen[0].std() < 0.2 * volume.voxel_size
    assert seen[0].std() < 0.7 * seen[1].std()


def test_a_wrong_silhouette_is_tolerated(temple: BuiltInScene) -> None:
    scene = temple.scene
    view = scene.views[0]
    broken = replace(view, mask=np.zeros((view.height, view.width), np.bool_))
    wrong = replace(scene, views=(broken, *scene.views[1:]))
    volume = volume_of(scene, 30_000)
    with pytest.raises(EmptyReconstructionError, match=r"view01\.png alone leaves 0\.0%"):
        VisualHull().carve(wrong, volume)
    assert (
        VisualHull(tolerance=1).carve(wrong, volume).with_interior.n_occupied
        >= VisualHull().carve(scene, volume).with_interior.n_occupied
    )
    with pytest.raises(ValueError, match="expected a tolerance of 0 to 7"):
        VisualHull(tolerance=8).carve(scene, volume)


def test_no_silhouettes_is_a_clear_error(temple: BuiltInScene) -> None:
    scene = without_silhouettes(temple.scene)
    with pytest.raises(SceneError, match="needs silhouettes"):
        VisualHull().carve(scene, volume_of(scene, 5000))


def test_what_lies_outside_an_image_is_unknown(temple: BuiltInScene) -> None:
    scene = temple.scene
    view = scene.views[0]
    assert view.silhouette is not None
    half = view.width // 2
    cropped = View.from_matrices(
        view.K,
        view.cam_from_world,
        view.image[:, :half].copy(),
        silhouette=view.silhouette[:, :half].copy(),
        name="half",
    )
    volume = volume_of(scene, 20_000)
    alone = VisualHull().carve(replace(scene, views=(cropped,)), volume)
    beyond = volume.centers()[:, :]
    pixels, _ = view.project(beyond)
    outside = (pixels[:, 0] > half).reshape(volume.shape)
    assert alone.with_interior.occupied[outside].all()


def test_the_item_buffer_is_brute_force_ray_casting_after_every_round() -> None:
    scene = little_temple(n_views=3, width=32, height=24).scene
    volume = volume_of(scene, 2000)
    buffer = ItemBuffer(scene.packed, volume)
    occupied = np.ones(volume.shape, np.bool_)
    rng = np.random.default_rng(3)
    for _ in range(4):
        newly = buffer.advance(occupied)
        np.testing.assert_array_equal(buffer.items, brute_force_items(scene, volume, occupied))
        assert occupied.ravel()[newly].all()
        visible = buffer.visible()
        occupied.ravel()[rng.choice(visible, len(visible) // 2, replace=False)] = False


def test_patches_of_the_item_buffer_are_the_pixels_that_see_the_voxel() -> None:
    scene = little_temple(n_views=3, width=48, height=36).scene
    volume = volume_of(scene, 2000)
    buffer = ItemBuffer(scene.packed, volume)
    buffer.advance(np.ones(volume.shape, np.bool_))
    visible = buffer.visible()
    patches = buffer.patches(visible)
    for n in range(0, len(visible), 7):
        for j, view in enumerate(scene.views):
            expected = view.image[buffer.items[j] == visible[n]]
            found = patches.colors[patches.view_starts[n, j] : patches.view_starts[n, j + 1]]
            np.testing.assert_array_equal(found, expected)


def test_a_camera_inside_the_volume_sees_from_its_own_voxel_on() -> None:
    scene = little_temple(n_views=2, width=32, height=24).scene
    center = scene.views[0].center
    wide = replace(scene, bounds=Bounds(np.minimum(scene.bounds.low, center - 0.05), center + 0.05))
    volume = volume_of(wide, 3000)
    buffer = ItemBuffer(wide.packed, volume)
    buffer.advance(np.ones(volume.shape, np.bool_))
    own = np.ravel_multi_index(tuple(((center - volume.origin) / volume.voxel_size).astype(int)), volume.shape)
    assert (buffer.items[0][wide.views[0].silhouette] == own).all()


def test_the_photo_hull_lies_between_the_object_and_the_visual_hull(temple: BuiltInScene) -> None:
    scene = temple.scene
    volume = volume_of(scene, 60_000)
    hull = VisualHull().carve(scene, volume)
    carved = GeneralizedVoxelColoring(StandardDeviation(threshold=70)).carve(scene, volume)
    assert (carved.with_interior.occupied <= hull.with_interior.occupied).all()
    # A voxel wholly inside the object is never visible, so nothing can carve it.
    depth = distance_to_mesh(volume.centers(), temple.ground_truth).reshape(volume.shape)
    deep = hull.with_interior.occupied & (depth > 2.5 * volume.voxel_size) & _inside(temple, volume)
    assert deep.any()
    assert carved.with_interior.occupied[deep].all()


def _inside(temple: BuiltInScene, volume: CarvingVolume) -> NDArray[np.bool_]:
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(temple.ground_truth))
    points = o3d.core.Tensor.from_numpy(volume.centers().astype(np.float32))
    return (caster.compute_occupancy(points).numpy() > 0).reshape(volume.shape)


def test_carving_ends_when_every_visible_voxel_is_connected_to_a_consistent_one(temple: BuiltInScene) -> None:
    hull = GeneralizedVoxelColoring(StandardDeviation(threshold=25)).carve(
        temple.scene, volume_of(temple.scene, 30_000)
    )
    visible = hull.labels == Label.CONSISTENT
    assert visible.any()
    assert (hull.degree[visible] >= 1 - 25 / 127.5 - 1e-6).all()  # one threshold: no candidates
    assert (hull.labels == Label.INCONSISTENT).sum() > 100


def test_a_test_that_carves_everything_ends_in_a_clear_error(temple: BuiltInScene) -> None:
    def never(patches: Patches) -> Verdict:
        zero = np.zeros(patches.n_voxels)
        return Verdict(zero, zero + 0.5, zero + 0.5)

    with pytest.raises(EmptyReconstructionError, match="carved all"):
        GeneralizedVoxelColoring(never).carve(temple.scene, volume_of(temple.scene, 3000))


def test_a_mesh_can_be_cut_to_what_some_view_sees(temple: BuiltInScene) -> None:
    mesh = o3d.geometry.TriangleMesh.create_box(0.06, 0.06, 0.06).translate((-0.03, -0.03, 0)).subdivide_midpoint(5)
    visibility = VertexVisibility.of(mesh, temple.scene)
    part, _, source = repair_mesh(mesh, kept=visibility.n_views > 0)
    assert 0 < len(part.triangles) < len(mesh.triangles)
    assert (visibility.of_vertices(source).n_views > 0).all()
    np.testing.assert_array_equal(np.asarray(part.vertices), np.asarray(mesh.vertices)[source])

    def underside(shape: o3d.geometry.TriangleMesh) -> int:
        return int((np.asarray(shape.vertices)[np.asarray(shape.triangles)][:, :, 2].max(axis=1) < 1e-6).sum())

    # Seen from nowhere above, but for slivers whose corners all lie on its rim.
    assert underside(part) < 0.05 * underside(mesh)


def test_open3ds_own_carving_agrees_but_for_a_margin(temple: BuiltInScene) -> None:
    # Open3D keeps a voxel where the mask is above 0 at any of its corners: up to a voxel and a pixel more than ours.
    scene = temple.scene
    volume = volume_of(scene, 20_000)
    grid = volume.to_voxel_grid()
    for view in scene.views:
        assert view.silhouette is not None
        mask = o3d.geometry.Image(view.silhouette.astype(np.float32))
        grid.carve_silhouette(mask, view.camera, True)
    kept = CarvingVolume.from_voxel_grid(grid, shape=volume.shape).occupied
    field = hull_distance(scene, volume)
    margin = np.sqrt(3) / 2 * volume.voxel_size + 1.5 * scene.pixel_footprint
    assert kept[field > 0].all()
    assert not kept[field < -margin].any()
    assert (field < -margin).sum() > 1000


def test_both_voxel_colourings_agree_where_both_apply(temple: BuiltInScene) -> None:
    # They differ in what a voxel sees: its footprint's box, or the rays that hit it.
    volume = volume_of(temple.scene, 60_000)
    test = StandardDeviation(threshold=60)
    first, second = (method(test).carve(temple.scene, volume) for method in (VoxelColoring, GeneralizedVoxelColoring))
    for a, b in ((first, second), (second, first)):
        distance, _ = cKDTree(b.volume.centers()).query(a.volume.centers())
        assert (distance < 1.8 * volume.voxel_size).mean() > 0.85


def test_what_a_monotone_test_accepts_is_never_carved(temple: BuiltInScene) -> None:
    def in_range(patches: Patches) -> Verdict:
        grey = patches.colors.mean(axis=1)
        spread = np.zeros(patches.n_voxels)
        if patches.n_voxels:
            first = patches.starts[:-1]
            spread = np.maximum.reduceat(grey, first) - np.minimum.reduceat(grey, first)
        limit = np.full(patches.n_voxels, 1 - 120 / 255)
        return Verdict(1 - spread / 255, limit, limit)

    volume = volume_of(temple.scene, 30_000)
    carved = GeneralizedVoxelColoring(in_range).carve(temple.scene, volume)
    kept = (carved.labels == Label.CONSISTENT) | (carved.labels == Label.HIDDEN)
    # Carving more than the photo hull would break the largest set that is consistent: carving it again changes nothing.
    again = GeneralizedVoxelColoring(in_range).carve(temple.scene, volume.with_occupancy(kept))
    np.testing.assert_array_equal(again.with_interior.occupied, carved.with_interior.occupied)
    assert kept.sum() < VisualHull().carve(temple.scene, volume).with_interior.n_occupied


def test_what_is_a_pixel_thin_stays_on_its_side_of_the_outline() -> None:
    mask = np.zeros((30, 30), np.bool_)
    mask[10, 5:25] = mask[20:22, 20:22] = True
    np.testing.assert_array_equal(outline_distance(mask) > 0, mask)
    np.testing.assert_array_equal(outline_distance(~mask) > 0, ~mask)
