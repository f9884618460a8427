"""Unit, place and orientation of the world change nothing but the numbers that are told in its unit."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
import scenes
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import recon3d
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.scene import Scene
from recon3d.scene.similarity import Similarity
from recon3d.stereo.patch_match import Matching

_SETTINGS = recon3d.Settings(
    n_voxels=15_000, matching=(Matching(stride=2, rounds=2),), carving=recon3d.carving.VoteCarving()
)
_TURNED = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # a box stays one


@pytest.fixture(scope="module")
def temple() -> Scene:
    return recon3d.datasets.little_temple(n_views=7, width=128, height=96, supersampling=1).scene


@pytest.fixture(scope="module")
def found(temple: Scene) -> recon3d.Reconstruction:
    return recon3d.reconstruct(temple, _SETTINGS)


@pytest.mark.parametrize(
    "to",
    [
        Similarity(1e-6, np.eye(3), np.zeros(3)),
        Similarity(1e3, np.eye(3), np.array([5e5, 4e6, 100.0])),
        Similarity(10.0, np.eye(3), np.array([1e6, -1e6, 1e6])),
    ],
    ids=["micrometres", "utm", "far"],
)
def test_unit_and_place_of_the_world_do_not_matter(
    temple: Scene, found: recon3d.Reconstruction, to: Similarity
) -> None:
    other = recon3d.reconstruct(scenes.moved(temple, to), _SETTINGS)
    # Rounding decides between planes that match as well, for a point in a hundred, and the mesh there follows.
    assert other.carved.counts() == pytest.approx(found.carved.counts(), abs=1e-3 * found.carved.lattice.n_voxels)
    assert len(other.points.points) == pytest.approx(len(found.points.points), rel=0.01)
    one, two = found.points.points, to.inverse()(np.asarray(other.points.points))
    gaps = cKDTree(one).query(two)[0] / temple.pixel_footprint
    assert np.median(gaps) < 1e-4
    assert np.percentile(gaps, 97) < 0.01
    distances = _apart(found, other, to)
    assert np.median(distances) < 1e-3
    assert np.percentile(distances, 95) < 0.03
    assert other.quality.overall.median == pytest.approx(found.quality.overall.median, abs=0.1)
    assert found.uncertainty is not None
    assert other.uncertainty is not None
    uncertainty = [np.median(each[np.isfinite(each)]) for each in (found.uncertainty, other.uncertainty)]
    assert uncertainty[1] == pytest.approx(to.scale * uncertainty[0], rel=0.01)


def test_a_turned_world_holds_the_same_surface(temple: Scene, found: recon3d.Reconstruction) -> None:
    to = Similarity(1.0, _TURNED, np.array([0.3, -0.2, 0.1]))
    other = recon3d.reconstruct(scenes.moved(temple, to), _SETTINGS)
    # Marching cubes cuts a turned lattice into other triangles, from which matching starts.
    assert other.carved.n_accepted == pytest.approx(found.carved.n_accepted, rel=0.03)
    assert len(other.points.points) == pytest.approx(len(found.points.points), rel=0.05)
    assert np.median(_apart(found, other, to)) < 0.15
    one, two = found.points.points, to.inverse()(np.asarray(other.points.points))
    assert np.median(cKDTree(one).query(two)[0]) < 0.5 * temple.pixel_footprint


def _apart(found: recon3d.Reconstruction, other: recon3d.Reconstruction, to: Similarity) -> NDArray[np.float64]:
    """Distances in voxels from the vertices of each of two meshes to the other, in the first's frame."""
    back = o3d.geometry.TriangleMesh(other.mesh)
    back.vertices = o3d.utility.Vector3dVector(to.inverse()(np.asarray(other.mesh.vertices)))
    pairs = ((found.mesh, back), (back, found.mesh))
    distances = [RayCaster(one).distances(np.asarray(two.vertices)) for one, two in pairs]
    return np.concatenate(distances) / found.carved.lattice.voxel_size
