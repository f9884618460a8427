"""Meshes of points and of voxels: in order, and with what was measured."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
from scenes import ball_volume, edge_counts, lattice_of, signed_volume

from recon3d import CarvedVolume, Label, Meshing, VisualHull, carve, mesh
from recon3d.carving import FineVisualHull
from recon3d.datasets import BuiltInScene
from recon3d.surface.extraction import mesh_shape, sparse_shape
from recon3d.surface.repair import Repairs


@pytest.fixture(scope="module")
def ball() -> CarvedVolume:
    """A ball of radius one, larger by a voxel than the points on it."""
    volume = ball_volume(1.1, 24)
    carved = CarvedVolume.untouched(volume)
    carved.labels[volume.occupied] = Label.HIDDEN
    return carved


@pytest.fixture(scope="module")
def points() -> o3d.t.geometry.PointCloud:
    """The upper half of the ball."""
    vectors = np.random.default_rng(0).standard_normal((20_000, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(vectors))
    cloud.point.normals = o3d.core.Tensor.from_numpy(vectors)
    cloud.point.confidence = o3d.core.Tensor.from_numpy(np.full((len(vectors), 1), 0.7))
    return cloud


@pytest.mark.parametrize("surface", ["poisson", "graph-cut"])
def test_a_mesh_of_points_is_measured_near_them_and_closed_by_the_hull(
    ball: CarvedVolume, points: o3d.t.geometry.PointCloud, surface: str
) -> None:
    found = mesh(ball, points, Meshing(surface), spacing=0.05)  # type: ignore[arg-type]
    places = np.asarray(found.mesh.vertices)
    assert (edge_counts(found.mesh) == 2).all()
    assert found.mesh.has_vertex_normals()
    assert not found.mesh.has_vertex_colors()
    assert found.measured[places[:, 2] > 0].all()
    assert not found.measured[places[:, 2] < -0.15].any()
    assert np.abs(np.linalg.norm(places[places[:, 2] > 0.1], axis=1) - 1).max() < 0.05
    # Poisson follows the hull below, a graph cut takes the shortest way.
    least = {"poisson": 4 / 3, "graph-cut": 2 / 3}[surface]
    assert signed_volume(found.mesh) > 0.95 * least * np.pi


def test_a_mesh_of_voxels_is_measured_throughout(temple: BuiltInScene) -> None:
    hull = carve(temple.scene, lattice_of(temple.scene, 30), VisualHull()).dense()
    found = mesh(hull, meshing=Meshing(smoothing=0, min_component=0))
    assert found.measured.all()
    assert len(found.measured) == len(found.mesh.vertices)
    expected = mesh_shape(hull.with_interior, distance=hull.distance, smoothing=0)
    assert len(found.mesh.triangles) == len(expected.triangles)
    assert found.repairs == Repairs()
    sparse = carve(temple.scene, lattice_of(temple.scene, 30), FineVisualHull())
    assert len(mesh(sparse, meshing=Meshing(min_component=0)).mesh.triangles) == len(sparse_shape(sparse).triangles)  # type: ignore[arg-type]


def test_a_shell_is_filled_where_that_is_wanted(ball: CarvedVolume) -> None:
    shell = CarvedVolume.untouched(ball.volume)
    shell.labels[...] = ball.labels
    near = ball.with_interior.surface()
    shell.labels[near] = Label.CONSISTENT
    shell.volume.occupied[near] = True
    volumes = [
        signed_volume(mesh(shell, meshing=Meshing(fill_hidden=fill), one_sided=one_sided).mesh)
        for fill, one_sided in ((False, True), (True, True), (False, False))
    ]
    assert volumes[0] < 0.5 * volumes[1]
    assert volumes[1] == volumes[2]


def test_small_components_are_dropped(ball: CarvedVolume) -> None:
    both = CarvedVolume.untouched(ball.volume)
    both.labels[...] = ball.labels
    both.labels[1, 1, 1] = Label.HIDDEN
    assert mesh(both).repairs.small_components == 1
    assert mesh(both, meshing=Meshing(min_component=0)).repairs.small_components == 0
