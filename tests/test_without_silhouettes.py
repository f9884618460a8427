"""Scenes whose background is unknown: what is measured of them, and what is left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh, cameras, edge_counts, grain, photographs

import recon3d
from recon3d import Bounds, Meshing, Scene, Settings
from recon3d.carving import GeneralizedVoxelColoring
from recon3d.scene import without_silhouettes
from recon3d.stereo import PASSES

N_VOXELS = 30_000


@pytest.fixture(scope="module")
def on_floor() -> Scene:
    """A unit ball on a floor that goes on beyond the bounds, from all around."""
    mesh = ball_mesh(1, 48) + box_mesh(7, 7, 0.2).translate((0, 0, -1.1))
    scene = without_silhouettes(photographs(mesh, grain, cameras(16, arc=360, width=160, height=120), supersampling=2))
    return replace(scene, bounds=Bounds([-1.02] * 3, [1.02] * 3), name="ball on a floor")


@pytest.fixture(scope="module")
def found(on_floor: Scene) -> recon3d.Reconstruction:
    return recon3d.reconstruct(on_floor, Settings(n_voxels=N_VOXELS))


@pytest.fixture(scope="module")
def wall() -> Scene:
    """A wall that goes on beyond the bounds on four sides, seen from one side."""
    mesh = box_mesh(0.2, 8, 8)
    scene = without_silhouettes(photographs(mesh, grain, cameras(6, arc=90, width=160, height=120), supersampling=2))
    return replace(scene, bounds=Bounds([-0.6, -1, -1], [0.6, 1, 1]), name="wall")


def test_dense_matching_is_the_default_and_the_mesh_is_open_where_nothing_was_measured(on_floor: Scene) -> None:
    resolved = Settings().resolved(on_floor)
    assert resolved.carving == recon3d.VoteCarving()
    assert resolved.matching == PASSES
    assert resolved.meshing.keep_unsupported is False
    assert Settings(meshing=Meshing(keep_unsupported=True)).resolved(on_floor).meshing.keep_unsupported is True


def test_views_that_cannot_be_matched_are_carved_by_a_test(on_floor: Scene) -> None:
    lone = replace(on_floor, views=on_floor.views[:1])
    resolved = Settings().resolved(lone)
    assert resolved.carving == GeneralizedVoxelColoring()
    assert resolved.matching is None


def test_the_object_is_measured(on_floor: Scene, found: recon3d.Reconstruction) -> None:
    vertices = np.asarray(found.mesh.vertices)
    error = np.abs(np.linalg.norm(vertices, axis=1) - 1) / on_floor.pixel_footprint
    assert np.median(error) < 0.3
    assert np.quantile(error, 0.95) < 2
    upper = np.asarray(ball_mesh(1, 48).vertices)
    upper = upper[upper[:, 2] > -0.3]
    gap = np.linalg.norm(upper[:, None] - vertices[None, ::5], axis=2).min(axis=1) / on_floor.pixel_footprint
    assert np.quantile(gap, 0.98) < 3  # the vertices' own distance, every fifth of them


def test_neither_floor_nor_faces_of_the_bounds_are_in_the_mesh(found: recon3d.Reconstruction) -> None:
    vertices = np.asarray(found.mesh.vertices)
    outside = np.linalg.norm(vertices, axis=1) > 1.1
    assert outside.mean() < 0.01
    assert (edge_counts(found.mesh) == 1).any()


def test_a_mesh_is_closed_where_that_is_asked_for(on_floor: Scene) -> None:
    settings = Settings(n_voxels=N_VOXELS, matching=PASSES[-1:], meshing=Meshing(keep_unsupported=True))
    result = recon3d.reconstruct(on_floor, settings)
    assert (edge_counts(result.mesh) == 2).all()
    assert (result.support == 0).any()


def test_a_wall_is_one_open_sheet(wall: Scene) -> None:
    result = recon3d.reconstruct(wall, Settings(n_voxels=N_VOXELS))
    vertices, normals = np.asarray(result.mesh.vertices), np.asarray(result.mesh.vertex_normals)
    front = 0.1 * np.sign(np.mean([view.center[0] for view in wall.views]))
    error = np.abs(vertices[:, 0] - front) / wall.pixel_footprint
    assert np.quantile(error, 0.9) < 0.5
    assert error.max() < 3.5  # the reach of a point, at the rims
    assert (np.abs(vertices) < np.add(wall.bounds.high, 3.5 * wall.pixel_footprint)).all()
    assert (np.abs(normals[:, 0]) > 0.9).mean() > 0.9
    covered = np.histogram2d(vertices[:, 1], vertices[:, 2], bins=8, range=[[-0.95, 0.95]] * 2)[0]
    assert (covered > 0).all()


@pytest.mark.parametrize("known", [lambda n: n % 2 == 0, lambda n: n == 0], ids=["every second", "one"])
def test_silhouettes_of_some_views_bound_the_object_too(known: Callable[[int], bool]) -> None:
    scene = photographs(ball_mesh(1, 48), grain, cameras(8, arc=360, width=96, height=72))
    views = tuple(view if known(n) else replace(view, mask=None) for n, view in enumerate(scene.views))
    some = replace(scene, views=views)
    carved = recon3d.carve(some, recon3d.volume.Lattice.enclosing(some.bounds, n_voxels=N_VOXELS)).dense()
    hull = recon3d.VisualHull().carve(some, carved.lattice).dense()
    assert solid(hull)[solid(carved)].all()
    assert solid(carved).sum() < solid(hull).sum()
    centers = np.moveaxis(np.indices(carved.volume.shape), 0, -1) + 0.5
    depth = 1 - np.linalg.norm(carved.lattice.origin + carved.lattice.voxel_size * centers, axis=-1)
    assert solid(carved)[depth > 3 * carved.lattice.voxel_size].all()


def solid(carved: recon3d.CarvedVolume) -> NDArray[np.bool_]:
    return carved.with_interior.occupied
