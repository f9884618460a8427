"""Carving from coarse to fine against the dense methods."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import psutil
import pytest
from reference import brute_force_items
from scenes import (
    ball_mesh,
    cameras,
    cropped,
    lattice_of,
    mask_of,
    photographs,
    plain_view,
    two_planes_mesh,
    with_noise,
)
from scipy.spatial import cKDTree

import recon3d
from recon3d.carving import METHODS
from recon3d.carving.bricks import BYTES_PER_BRICK, BrickItems, Bricks
from recon3d.carving.fine_generalized import FineGeneralizedVoxelColoring
from recon3d.carving.fine_visual_hull import FineVisualHull
from recon3d.carving.generalized import GeneralizedVoxelColoring
from recon3d.carving.method import Method
from recon3d.carving.start import outline_distance
from recon3d.carving.visual_hull import VisualHull
from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.consistency.deviation import StandardDeviation
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis
from recon3d.datasets.synthetic import BuiltInScene, little_temple
from recon3d.errors import ArgumentError, EmptyReconstructionError, SceneError, VolumeTooLargeError
from recon3d.io import Checkpoints
from recon3d.kernels.brick_rays import next_brick
from recon3d.kernels.bricks import BRICK, EMPTY, SOLID
from recon3d.kernels.item_buffer import next_voxel
from recon3d.kernels.types import Ray
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.stereo import PASSES
from recon3d.volume.carved import CarvedVolume
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume


def scene_named(name: str, temple: BuiltInScene) -> Scene:
    """One of the small scenes of these tests."""
    if name == "temple":
        return temple.scene
    if name == "planes":
        return photographs(two_planes_mesh(), taken_by=cameras(5, arc=200, width=70, height=50))
    ball = photographs(ball_mesh(), taken_by=cameras(6, arc=360))
    if name == "ball":
        return ball
    if name == "cropped ball":  # parts of the volume lie outside of every image
        return replace(ball, views=tuple(cropped(view, 30, 36) for view in ball.views))
    rng = np.random.default_rng(7)  # outlines everywhere
    views = tuple(replace(view, mask=rng.random((view.height, view.width)) < 0.995) for view in ball.views)
    return replace(ball, views=views)


def assert_same(sparse: SparseVolume, dense: CarvedVolume) -> None:
    """Lattice, occupancy, distance, visible voxels, their colours and surface are equal to the last bit."""
    solid = dense.with_interior
    assert sparse.shape == solid.shape
    assert sparse.voxel_size == solid.voxel_size
    np.testing.assert_array_equal(sparse.origin, solid.origin)
    occupied, distance = sparse.box((0, 0, 0), sparse.shape)
    np.testing.assert_array_equal(occupied, solid.occupied)
    if dense.distance is None:
        assert distance is None
    else:
        np.testing.assert_array_equal(distance, dense.distance)
    visible = mask_of(sparse, sparse.voxels(sparse.visible))
    np.testing.assert_array_equal(visible, dense.volume.occupied)
    np.testing.assert_array_equal(sparse.dense().volume.colors[visible], dense.volume.colors[visible])
    np.testing.assert_array_equal(mask_of(sparse, sparse.voxels()), solid.surface())
    assert sparse.n_occupied == solid.n_occupied


@pytest.mark.parametrize("tolerance", [0, 1])
@pytest.mark.parametrize("n_voxels", [4_000, 400_000])
@pytest.mark.parametrize("name", ["temple", "planes", "ball", "cropped ball", "torn ball"])
def test_the_fine_visual_hull_is_the_dense_one(name: str, n_voxels: int, tolerance: int, temple: BuiltInScene) -> None:
    scene = scene_named(name, temple)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=n_voxels)
    dense = VisualHull(tolerance=tolerance).carve(scene, volume)
    assert_same(
        FineVisualHull(tolerance=tolerance).carve(scene, volume),
        dense,
    )


@pytest.mark.parametrize("test", [FuzzyAdaptiveHysteresis(), StandardDeviation(15)], ids=["fuzzy", "deviation"])
@pytest.mark.parametrize("noise", [0, 8])
@pytest.mark.parametrize("silhouettes", [True, False])
@pytest.mark.parametrize(("name", "n_voxels"), [("temple", 30_000), ("planes", 30_000), ("ball", 300_000)])
def test_fine_generalized_voxel_coloring_is_the_dense_one(
    name: str, n_voxels: int, silhouettes: bool, noise: float, test: ConsistencyTest, temple: BuiltInScene
) -> None:
    scene = with_noise(scene_named(name, temple), noise)
    if not silhouettes:
        scene = without_silhouettes(scene)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=n_voxels)
    dense = GeneralizedVoxelColoring(test).carve(scene, volume)
    assert_same(
        FineGeneralizedVoxelColoring(test).carve(scene, volume),
        dense,
    )


@pytest.mark.parametrize("connectivity", [6, 18, 26])
def test_candidates_are_carried_across_bricks_by_the_same_neighbours(connectivity: int, temple: BuiltInScene) -> None:
    scene = with_noise(temple.scene, 8)
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=20_000)
    dense = GeneralizedVoxelColoring(connectivity=connectivity).carve(scene, volume)  # type: ignore[arg-type]
    fine = FineGeneralizedVoxelColoring(connectivity=connectivity).carve(scene, volume)  # type: ignore[arg-type]
    assert_same(fine, dense)


def test_the_hull_stores_bricks_near_the_surface_alone(temple: BuiltInScene) -> None:
    def stored(n: int) -> tuple[int, float]:
        hull = FineVisualHull().carve(temple.scene, lattice_of(temple.scene, n))
        assert (hull.slots == SOLID).any()
        assert (hull.slots == EMPTY).any()
        return hull.occupied.size, float(np.prod(hull.shape))

    (coarse, coarse_volume), (fine, fine_volume) = stored(128), stored(256)
    assert fine_volume / coarse_volume > 7.8
    # A surface has four times as many voxels at half the size; a rim of constant width in voxels brings it down.
    assert fine / coarse < 5


def test_distances_to_an_outline_are_the_same_at_every_call() -> None:
    rng = np.random.default_rng(0)
    mask = rng.random((50, 70)) < 0.995
    first = outline_distance(mask)
    kept = []
    for _ in range(100):
        kept.append(np.empty(rng.integers(10, 5000), np.uint8))  # so that results lie elsewhere in memory
        np.testing.assert_array_equal(outline_distance(mask), first)


def test_rays_that_leave_a_brick_in_one_step_cross_the_walls_that_single_steps_cross() -> None:
    rng = np.random.default_rng(1)
    shape = (29, 16, 21)
    for n in range(4000):
        start = rng.uniform(-20, 50, 3)
        step = rng.standard_normal(3)
        if n % 2:  # through the lattice's corners and edges, and along its axes
            start, step = np.round(start), rng.integers(-2, 3, 3).astype(float)
        place = rng.integers(0, shape)
        single = place.copy()
        ray, by_voxels = Ray(start, step, place), Ray(start, step, single)
        brick = place // BRICK
        inside = True
        while inside and (single // BRICK == brick).all() and step.any():
            inside = next_voxel(shape, by_voxels)
        assert next_brick(shape, ray) == (inside and step.any())
        if inside and step.any():
            np.testing.assert_array_equal(place, single)


def test_the_item_buffer_of_bricks_is_brute_force_ray_casting_after_every_round() -> None:
    scene = little_temple(n_views=3, width=32, height=24).scene
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=6000)
    bricks = Bricks(volume.lattice)
    bricks.store_ends()
    buffer = BrickItems(scene.packed, bricks)
    occupied = volume.occupied.copy()
    rng = np.random.default_rng(3)
    for _ in range(4):
        newly = buffer.advance()
        expected = brute_force_items(scene, volume, occupied)
        places = np.arange(bricks.n_places).reshape(bricks.occupied.shape)
        flat = np.full(bricks.n_places + 1, -1)
        slot, *local = np.nonzero(places >= 0)
        voxels = BRICK * bricks.bricks[slot] + np.column_stack(local)
        within = (voxels < volume.shape).all(axis=1)
        flat[:-1][within] = np.ravel_multi_index(tuple(voxels[within].T), volume.shape)
        np.testing.assert_array_equal(flat[np.maximum(buffer.items, -1)], expected)
        assert bricks.occupied.ravel()[newly].all()
        visible = buffer.visible()
        gone = rng.choice(visible, len(visible) // 2, replace=False)
        bricks.occupied.reshape(-1)[gone] = False
        occupied.ravel()[flat[gone]] = False


def test_a_camera_inside_the_volume_sees_the_same_from_bricks() -> None:
    scene = without_silhouettes(little_temple(n_views=2, width=32, height=24).scene)
    center = scene.views[0].center
    wide = replace(scene, bounds=Bounds(np.minimum(scene.bounds.low, center - 0.05), center + 0.05))
    volume = CarvingVolume.enclosing(wide.bounds, n_voxels=40_000)
    test = StandardDeviation(20)
    fine = FineGeneralizedVoxelColoring(test).carve(wide, volume)
    assert_same(fine, GeneralizedVoxelColoring(test).carve(wide, volume))


@pytest.mark.parametrize("method", [FineVisualHull(), FineGeneralizedVoxelColoring()])
def test_one_thread_equals_two(method: Method, temple: BuiltInScene) -> None:
    results = []
    threads = numba.get_num_threads()
    for count in (1, threads):
        numba.set_num_threads(count)
        results.append(method.carve(with_noise(temple.scene, 8), lattice_of(temple.scene, 60)))
    one, two = results
    for name in ("slots", "occupied", "visible", "colors", "distance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_surface_voxels_that_no_pixel_sees_take_the_nearest_measured_colour(temple: BuiltInScene) -> None:
    hull = FineVisualHull().carve(temple.scene, lattice_of(temple.scene, 100))
    unseen = hull.surface() & ~hull.visible
    assert unseen.any()
    measured = hull.voxels(hull.visible)
    distance, _ = cKDTree(measured).query(hull.voxels(unseen))
    for n in range(0, len(distance), 97):
        voxel = hull.voxels(unseen)[n]
        nearest = np.linalg.norm(measured - voxel, axis=1) <= distance[n] + 1e-9
        assert (hull.colors[hull.visible][nearest] == hull.colors[unseen][n]).all(axis=1).any()


def test_bricks_that_would_not_fit_are_refused_with_a_size_that_would(
    monkeypatch: pytest.MonkeyPatch, temple: BuiltInScene
) -> None:
    side = temple.scene.bounds.longest
    free = 600 * BYTES_PER_BRICK
    monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=free))
    with pytest.raises(VolumeTooLargeError, match=r"voxels of .* would need .* GiB") as caught:
        FineVisualHull().carve(temple.scene, Lattice.enclosing(temple.scene.bounds, voxel_size=side / 300))
    found = re.search(r"a voxel size of (\S+) would fit", str(caught.value))
    assert found
    fitting = Lattice.enclosing(temple.scene.bounds, voxel_size=float(found[1]))
    assert len(FineVisualHull().carve(temple.scene, fitting).occupied) <= 600


@pytest.mark.parametrize("method", [FineVisualHull(), FineGeneralizedVoxelColoring()])
def test_an_absurd_lattice_is_refused_before_it_is_allocated(method: Method, temple: BuiltInScene) -> None:
    with pytest.raises(VolumeTooLargeError, match="would fit"):
        method.carve(temple.scene, Lattice.enclosing(temple.scene.bounds, voxel_size=1e-8))


@pytest.mark.parametrize("method", [FineVisualHull(), FineGeneralizedVoxelColoring()])
def test_a_part_of_a_volume_is_refused_since_carving_starts_from_a_whole_lattice(
    method: Method, temple: BuiltInScene
) -> None:
    volume = CarvingVolume.full(lattice_of(temple.scene, 10))
    volume.occupied[0] = False
    with pytest.raises(ArgumentError, match=r"a full volume, got one with .* empty voxels"):
        method.carve(temple.scene, volume)


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan"), float("inf")])
def test_a_voxel_size_must_be_positive(size: float, temple: BuiltInScene) -> None:
    with pytest.raises(ValueError, match=r"voxel_size to be a number in \(0, inf\)"):
        Lattice.enclosing(temple.scene.bounds, voxel_size=size)


def test_a_hull_without_silhouettes_is_a_clear_error(temple: BuiltInScene) -> None:
    with pytest.raises(SceneError, match="needs silhouettes"):
        FineVisualHull().carve(without_silhouettes(temple.scene), lattice_of(temple.scene, 40))


def test_silhouettes_with_nothing_in_common_name_the_view_that_excludes_most(temple: BuiltInScene) -> None:
    bad = replace(temple.scene.views[3], mask=np.zeros((120, 160), np.bool_))
    scene = replace(temple.scene, views=(*temple.scene.views[:3], bad, *temple.scene.views[4:]))
    with pytest.raises(EmptyReconstructionError, match=rf"{bad.name} alone leaves 0\.0%"):
        FineVisualHull().carve(scene, Lattice.enclosing(scene.bounds, voxel_size=0.004))


def test_a_test_that_carves_everything_is_a_clear_error() -> None:
    def never(patches: Patches) -> Verdict:
        zero = np.zeros(patches.n_voxels)
        return Verdict(zero, zero + 0.5, zero + 0.5)

    scene = Scene((plain_view(),), Bounds([-1, -1, -1], [1, 1, 1]))
    with pytest.raises(EmptyReconstructionError, match="carved all 1,000 voxels"):
        FineGeneralizedVoxelColoring(never).carve(scene, Lattice.enclosing(scene.bounds, voxel_size=0.2))


@pytest.mark.parametrize("name", ["fine-visual-hull", "fine-generalized-voxel-coloring"])
def test_a_fine_method_is_reconstructed_saved_kept_and_refined_like_its_dense_twin(
    name: str, temple: BuiltInScene, tmp_path: Path
) -> None:
    fine = recon3d.Settings(n_voxels=30_000, carving=METHODS[name]())
    dense = replace(fine, carving=METHODS[name]().dense())
    checkpoints = Checkpoints(tmp_path / "stages")
    result = recon3d.reconstruct(temple.scene, fine, checkpoints=checkpoints)
    other = recon3d.reconstruct(temple.scene, dense)
    assert isinstance(result.carved, SparseVolume)
    assert result.carved.lattice == other.carved.lattice
    counts, others = result.carved.counts(), other.carved.counts()
    assert (counts["consistent"], counts["hidden"]) == (others["consistent"], others["hidden"])
    assert sum(counts.values()) == sum(others.values())
    assert result.carved.n_accepted == other.carved.n_accepted
    assert len(result.mesh.vertices) == len(other.mesh.vertices)
    np.testing.assert_allclose(result.quality.overall.median, other.quality.overall.median, atol=0.5)
    normals = np.asarray(result.points.normals)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    written = recon3d.save(result, tmp_path / "out", pictures=False)
    assert set(written) == set(recon3d.save(other, tmp_path / "other", pictures=False))
    assert recon3d.Settings.from_record(result.record()["settings"]) == result.settings

    again = recon3d.reconstruct(temple.scene, fine, checkpoints=checkpoints)
    assert again.carved == result.carved
    one, two = (recon3d.refine(temple.scene, r.carved.dense(), passes=PASSES[2:]) for r in (result, other))
    np.testing.assert_array_equal(one.points.point.positions.numpy(), two.points.point.positions.numpy())


def test_a_fine_method_leaves_an_observer_to_its_dense_twin(temple: BuiltInScene) -> None:
    method = FineGeneralizedVoxelColoring(max_rounds=7)
    assert method.dense() == GeneralizedVoxelColoring(max_rounds=7)
    assert FineVisualHull(tolerance=2).dense() == VisualHull(tolerance=2)
    with pytest.raises(ArgumentError, match="give it to the method's dense"):
        method.carve(temple.scene, lattice_of(temple.scene, 10), observer=object())  # type: ignore[arg-type]
