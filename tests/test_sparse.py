"""Sparse volumes and their meshes against the dense ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import (
    edge_counts,
    lattice_of,
    mask_of,
    signed_volume,
)
from scipy.spatial import cKDTree

from recon3d.carving.fine_generalized import FineGeneralizedVoxelColoring
from recon3d.carving.fine_visual_hull import FineVisualHull
from recon3d.carving.generalized import GeneralizedVoxelColoring
from recon3d.carving.visual_hull import VisualHull
from recon3d.consistency.deviation import StandardDeviation
from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import EmptyReconstructionError
from recon3d.kernels.bricks import BRICK, EMPTY, SOLID
from recon3d.surface.extraction import mesh_sparse, mesh_volume
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice
from recon3d.volume.sparse import SparseVolume, brick_grid


def stored_throughout(occupied: NDArray[np.bool_], voxel_size: float = 0.5) -> SparseVolume:
    """Sparse volume at (1, 2, 3) all of whose bricks are stored, red."""
    shape = occupied.shape
    grid = brick_grid(shape)
    padded = np.zeros([BRICK * n for n in grid], np.bool_)
    padded[: shape[0], : shape[1], : shape[2]] = occupied
    voxels = padded.reshape(grid[0], BRICK, grid[1], BRICK, grid[2], BRICK).transpose(0, 2, 4, 1, 3, 5)
    voxels = voxels.reshape(-1, BRICK, BRICK, BRICK).copy()
    slots = np.arange(len(voxels), dtype=np.int32).reshape(grid)
    colors = np.zeros((*voxels.shape, 3), np.uint8)
    colors[voxels] = (255, 0, 0)
    return SparseVolume(np.array([1.0, 2.0, 3.0]), voxel_size, shape, slots, voxels, voxels.copy(), colors)


def test_the_voxel_grid_holds_the_surface_with_its_lattice_and_colours(temple: BuiltInScene) -> None:
    hull = FineVisualHull().carve(temple.scene, lattice_of(temple.scene, 50))
    back = CarvingVolume.from_voxel_grid(hull.to_voxel_grid(), shape=hull.shape)
    np.testing.assert_array_equal(back.origin, hull.origin)
    assert back.voxel_size == hull.voxel_size
    surface = mask_of(hull, hull.voxels())
    np.testing.assert_array_equal(back.occupied, surface)
    visible = hull.dense().volume
    np.testing.assert_array_equal(back.colors[visible.occupied], visible.colors[visible.occupied])
    np.testing.assert_array_equal(back.centers(), hull.centers()[np.lexsort(hull.voxels().T[::-1])])


@pytest.mark.parametrize("smoothing", [0, 5])
@pytest.mark.parametrize("known", [True, False], ids=["distance", "occupancy"])
@pytest.mark.parametrize("carve", [False, True], ids=["hull", "carved"])
def test_the_sparse_mesh_is_the_dense_one(carve: bool, known: bool, smoothing: int, temple: BuiltInScene) -> None:
    size = temple.scene.bounds.longest / 90
    volume = CarvingVolume.enclosing(temple.scene.bounds, voxel_size=size)
    if carve:
        sparse = FineGeneralizedVoxelColoring(StandardDeviation(25)).carve(
            temple.scene, Lattice.enclosing(temple.scene.bounds, voxel_size=size)
        )
        dense = GeneralizedVoxelColoring(StandardDeviation(25)).carve(temple.scene, volume)
    else:
        sparse, dense = (
            FineVisualHull().carve(temple.scene, Lattice.enclosing(temple.scene.bounds, voxel_size=size)),
            VisualHull().carve(temple.scene, volume),
        )
    if not known:
        sparse = replace(sparse, distance=None)
    mesh = mesh_sparse(sparse, smoothing=smoothing)
    other = mesh_volume(
        dense.with_interior, colors_from=dense.volume, distance=dense.distance if known else None, smoothing=smoothing
    )
    assert (edge_counts(mesh) == 2).all()
    assert len(mesh.triangles) == len(other.triangles)
    assert len(mesh.vertices) == len(other.vertices)
    distance, nearest = cKDTree(np.asarray(other.vertices)).query(np.asarray(mesh.vertices))
    assert distance.max() < 1e-3 * size  # positions are single precision within marching cubes
    assert signed_volume(mesh) == pytest.approx(signed_volume(other), rel=1e-5)
    colors, others = np.asarray(mesh.vertex_colors), np.asarray(other.vertex_colors)[nearest]
    # The eighth of equally near voxels may be another one.
    assert np.abs(colors - others).mean() < 2e-3
    normals = (np.asarray(mesh.vertex_normals) * np.asarray(other.vertex_normals)[nearest]).sum(axis=1)
    assert np.median(normals) > 0.9999


@pytest.mark.parametrize("smoothing", [0, 5])
@pytest.mark.parametrize("density", [0.03, 0.5, 1.0])
def test_the_sparse_mesh_is_closed_and_edge_manifold_across_blocks(density: float, smoothing: int) -> None:
    shape = (70, 66, 15)
    occupied = np.random.default_rng(0).random(shape) < density
    mesh = mesh_sparse(stored_throughout(occupied), smoothing=smoothing)
    assert (edge_counts(mesh) == 2).all()
    assert mesh.is_edge_manifold(allow_boundary_edges=False)


def test_distances_of_exactly_zero_leave_the_mesh_manifold() -> None:
    volume = stored_throughout(np.ones((24, 24, 24), np.bool_), 1.0)
    away = np.linalg.norm(volume.voxels(volume.occupied) - 11.5, axis=1)
    distance = np.zeros(volume.occupied.shape, np.float32)
    distance[volume.occupied] = np.round(2 * (9 - away)) / 2
    assert (distance == 0).sum() > 300
    for smoothing in (0, 5):
        mesh = mesh_sparse(replace(volume, occupied=distance > 0, distance=distance), smoothing=smoothing)
        assert (edge_counts(mesh) == 2).all()


def test_boxes_reach_over_the_lattice_into_empty_space() -> None:
    occupied = np.random.default_rng(5).random((9, 17, 8)) < 0.5
    volume = stored_throughout(occupied)
    box, distance = volume.box((-3, 2, -1), (15, 20, 12))
    assert distance is None
    np.testing.assert_array_equal(box[3:12, :15, 1:9], occupied[:, 2:])
    assert box.sum() == occupied[:, 2:].sum()
    np.testing.assert_array_equal(volume.dense().with_interior.occupied, occupied)
    np.testing.assert_array_equal(np.sort(volume.centers(volume.occupied), 0)[0], [1.25, 2.25, 3.25])


def test_sparse_volumes_show_themselves(temple: BuiltInScene) -> None:
    hull = FineVisualHull().carve(temple.scene, lattice_of(temple.scene, 40))
    assert "40 = " in str(hull.summary()["voxels"])
    picture, dense = (
        hull.picture(),
        VisualHull().carve(temple.scene, hull.lattice),
    )
    assert picture.shape == dense.volume.picture().shape
    # The same outlines; the dense picture leaves out what no pixel sees.
    white = (picture == 255).all(axis=2)
    assert (white == (dense.with_interior.picture() == 255).all(axis=2)).mean() > 0.99
    assert "SparseVolume" in hull._repr_html_()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"origin": np.zeros(2)}, "origin of three finite numbers"),
        ({"voxel_size": 0.0}, "expected voxel_size"),
        ({"shape": (0, 8, 8)}, "three positive numbers"),
        ({"shape": (17, 8, 8)}, "int32 slots"),
        ({"slots": np.full((2, 1, 1), EMPTY, np.int32)}, "each of the 2 stored bricks once"),
        ({"slots": np.array([[[0]], [[0]]], np.int32)}, "each of the 2 stored bricks once"),
        ({"visible": np.ones((1, 8, 8, 8), np.bool_)}, "expected visible"),
        ({"colors": np.zeros((2, 8, 8, 8), np.uint8)}, "expected colors"),
        ({"distance": np.zeros((2, 8, 8, 8))}, "expected distance"),
    ],
)
def test_what_does_not_fit_together_is_refused(change: dict[str, object], message: str) -> None:
    volume = stored_throughout(np.ones((16, 8, 8), np.bool_))
    with pytest.raises(ValueError, match=message):
        replace(volume, **change)  # type: ignore[arg-type]


def test_a_solid_brick_at_the_surface_is_refused() -> None:
    volume = stored_throughout(np.ones((24, 24, 24), np.bool_))
    slots = volume.slots.copy()
    slots[slots == 26] = slots[1, 1, 1]
    slots[1, 1, 1] = SOLID
    stored = {name: getattr(volume, name)[:26] for name in ("occupied", "visible", "colors")}
    assert replace(volume, slots=slots, **stored).n_occupied == 24**3
    slots[2, 1, 1], slots[1, 1, 1] = SOLID, slots[2, 1, 1]
    with pytest.raises(ValueError, match="1 solid bricks border on an empty voxel"):
        replace(volume, slots=slots, **stored)


def test_an_empty_volume_has_no_surface() -> None:
    empty = stored_throughout(np.zeros((9, 9, 9), np.bool_))
    for function in (mesh_sparse, SparseVolume.to_voxel_grid):
        with pytest.raises(EmptyReconstructionError, match="no surface"):
            function(empty)
