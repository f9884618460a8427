from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
from exact import distance_to_triangle, exact_distances
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh

from recon3d.evaluation.distances import sample_surface
from recon3d.evaluation.triangles import covering_samples, nearest_triangles
from recon3d.kernels.triangles import to_triangle


def mesh_of(corners: NDArray[np.float64]) -> o3d.geometry.TriangleMesh:
    """Mesh of triangles (n, 3, 3) that share no vertices."""
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(corners.reshape(-1, 3)),
        o3d.utility.Vector3iVector(np.arange(3 * len(corners)).reshape(-1, 3)),
    )


def corners_of(mesh: o3d.geometry.TriangleMesh) -> NDArray[np.float64]:
    return np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]


def pin(length: float, radius: float) -> o3d.geometry.TriangleMesh:
    """Cylinder whose sides are slivers."""
    return o3d.geometry.TriangleMesh.create_cylinder(radius, length, 200, 1)


def scattered(seed: int, n: int, size: float) -> o3d.geometry.TriangleMesh:
    """Triangles of any shape in a cube of side 2."""
    rng = np.random.default_rng(seed)
    return mesh_of(rng.uniform(-1, 1, (n, 1, 3)) + size * rng.standard_normal((n, 3, 3)))


@pytest.mark.parametrize("thin", [1.0, 1e-3, 1e-6, 1e-9])
def test_the_distance_to_a_triangle_is_to_its_plane_or_to_an_edge(thin: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(500):
        a, b, along = rng.standard_normal((3, 3))
        c = a + rng.uniform(-0.5, 1.5) * (b - a) + thin * along
        p = 2 * rng.standard_normal(3)
        got = np.sqrt(to_triangle(p, np.stack([a, b, c])))
        assert got == pytest.approx(distance_to_triangle(p, a, b, c), rel=1e-6)


def test_a_triangle_without_area_is_a_segment_or_a_point() -> None:
    a, b = np.array([1.0, 0, 0]), np.array([3.0, 0, 0])
    p = np.array([2.0, 3, 4])
    for order in ((a, b, (a + b) / 2), (a, a, b), (a, b, a), (b, a, a)):
        assert to_triangle(p, np.stack(order)) == pytest.approx(25.0)
    assert to_triangle(p, np.stack([a, a, a])) == pytest.approx(26.0)


PAIRS = {
    "balls": (ball_mesh(1.0, 20), ball_mesh(1.0, 20).translate((0.02, 0.01, 0))),
    "balls far apart": (ball_mesh(1.0, 20), ball_mesh(1.0, 20).translate((30.0, 0, 0))),
    "a ball in another": (ball_mesh(0.1, 10), ball_mesh(1.0, 30)),
    "boxes of huge triangles": (box_mesh(1, 2, 3), box_mesh(1.01, 2.02, 2.9)),
    "a fine ball and a coarse one": (ball_mesh(1.0, 30), ball_mesh(1.0, 4)),
    "a coarse ball and a fine one": (ball_mesh(1.0, 4), ball_mesh(1.0, 30)),
    "a ball on a plate": (ball_mesh(0.2, 10), ball_mesh(0.2, 30).translate((0, 0, 0.2)) + box_mesh(20, 20, 0.1)),
    "slivers": (pin(3.0, 0.1), pin(3.1, 0.11)),
    "a ball and slivers": (ball_mesh(1.0, 20), pin(3.0, 0.5) + pin(1.5, 0.01)),
    "scattered triangles": (scattered(0, 300, 0.2), scattered(1, 300, 0.2)),
    "large and small triangles": (scattered(2, 50, 1.0), scattered(3, 20, 1.0) + scattered(4, 2000, 0.003)),
    "far from the origin": (
        ball_mesh(1.0, 20).translate((3e4, 2e4, 1e4)),
        ball_mesh(1.0, 9).translate((3e4, 2e4 + 0.01, 1e4)),
    ),
}


@pytest.mark.parametrize("name", PAIRS)
def test_distances_to_the_nearest_triangles_are_exact_to_one_percent(name: str) -> None:
    source, target = PAIRS[name]
    rng = np.random.default_rng(0)
    near = sample_surface(source, np.sqrt(source.get_surface_area() / 600), rng)[0]
    around = rng.uniform(target.get_min_bound(), target.get_max_bound(), (600, 3))
    on = sample_surface(target, np.sqrt(target.get_surface_area() / 200), rng)[0]
    points = np.concatenate([near, around, on])
    nearest = nearest_triangles(points, target)
    got, exact = np.sqrt(nearest.squared), exact_distances(points, target)
    np.testing.assert_allclose(got, exact, rtol=0.01, atol=1e-6 * float(np.ptp(corners_of(target), axis=(0, 1)).max()))
    assert (got >= exact * (1 - 1e-6) - 1e-9).all()
    corners = corners_of(target)[nearest.triangle]
    np.testing.assert_array_equal(
        nearest.squared, [to_triangle(p, own) for p, own in zip(points, corners, strict=True)]
    )


def test_triangles_without_area_have_distances_too() -> None:
    dots = mesh_of(np.repeat(np.array([[[0.0, 0, 0]], [[1.0, 0, 0]]]), 3, axis=1))
    points = np.array([[0.0, 0, 0], [0.9, 0, 0], [0, 3, 4]])
    nearest = nearest_triangles(points, dots)
    np.testing.assert_allclose(np.sqrt(nearest.squared), [0, 0.1, 5])
    assert nearest.triangle.tolist() == [0, 1, 0]


@pytest.mark.parametrize("name", PAIRS)
def test_no_point_of_a_triangle_is_out_of_reach_of_its_samples(name: str) -> None:
    corners = corners_of(PAIRS[name][1])
    most = len(corners) + 1000
    samples, owners, reach = covering_samples(corners, most)
    assert len(corners) <= len(samples) == len(owners) <= most
    rng = np.random.default_rng(0)
    for n in rng.choice(len(corners), 12):
        mine = samples[owners == n]
        points = rng.dirichlet((0.5, 0.5, 0.5), 200) @ corners[n]
        distance = np.linalg.norm(points[:, None] - mine, axis=2)
        assert distance.min(axis=1).max() <= reach * (1 + 1e-9)
        assert max(np.sqrt(to_triangle(sample, corners[n])) for sample in mine) <= 1e-9 * np.abs(corners).max()


def test_one_large_triangle_is_covered_as_densely_as_many_small_ones() -> None:
    large = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    _, _, reach = covering_samples(large, 5000)
    # A disc of that radius around every sample covers the triangle a few times.
    assert 5000 * np.pi * reach**2 < 12 * 0.5
    sliver = np.array([[[0.0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]]])
    assert covering_samples(sliver, 1000)[2] < 10 / 1000
