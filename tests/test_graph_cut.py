from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import edge_counts, full_volume, signed_volume

from recon3d.errors import EmptyReconstructionError
from recon3d.surface.minimum_cut import graph_cut
from recon3d.volume.carved import CarvedVolume, Label

N = 40  # voxels along the lattice's edge, which are units


def hull_of(inside: NDArray[np.bool_]) -> CarvedVolume:
    """Hull of the voxels in a mask, on a lattice of unit voxels from the origin."""
    hull = CarvedVolume.untouched(full_volume(inside.shape))
    hull.labels[inside] = Label.HIDDEN
    return hull


def centers() -> NDArray[np.float64]:
    """(N, N, N, 3) voxel centres."""
    return np.stack(np.meshgrid(*(np.arange(N) + 0.5,) * 3, indexing="ij"), axis=-1)


def ball_hull(radius: float) -> CarvedVolume:
    """Hull of a ball in the lattice's middle."""
    return hull_of(np.linalg.norm(centers() - N / 2, axis=-1) <= radius)


def directions(n: int, seed: int = 0) -> NDArray[np.float64]:
    """(n, 3) random unit vectors."""
    vectors = np.random.default_rng(seed).standard_normal((n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def cloud(
    positions: NDArray[np.float64], normals: NDArray[np.float64], confidence: float = 1.0
) -> o3d.t.geometry.PointCloud:
    """Points of equal confidence."""
    points = o3d.t.geometry.PointCloud()
    values = {"positions": positions, "normals": normals}
    for name, value in {**values, "confidence": np.full(len(positions), confidence)}.items():
        points.point[name] = o3d.core.Tensor.from_numpy(np.ascontiguousarray(value, np.float32))
    return points


def face_points(low: list[float], high: list[float], normal: list[float], n: int) -> NDArray[np.float64]:
    """(n, 6) random positions in a flat box, and its normal."""
    positions = np.random.default_rng(0).uniform(low, high, (n, 3))
    return np.hstack([positions, np.tile(np.array(normal, float), (n, 1))])


def is_inside(mesh: o3d.geometry.TriangleMesh, positions: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) which positions (n, 3) a closed mesh holds."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    return np.asarray(scene.compute_occupancy(positions.astype(np.float32)).numpy() > 0.5)


def n_components(mesh: o3d.geometry.TriangleMesh) -> int:
    return len(mesh.cluster_connected_triangles()[1])


BALL = directions(20_000)
RADIUS = 13.3


def ball_points(keep: NDArray[np.bool_] | slice = slice(None)) -> o3d.t.geometry.PointCloud:
    """Points on a ball of 13.3 voxels' radius in the lattice's middle."""
    return cloud(N / 2 + RADIUS * BALL[keep], BALL[keep])


def radii(mesh: o3d.geometry.TriangleMesh) -> NDArray[np.float64]:
    return np.linalg.norm(np.asarray(mesh.vertices) - N / 2, axis=1)


def test_a_balls_surface_is_found_to_a_fraction_of_a_voxel() -> None:
    mesh = graph_cut(ball_points(), ball_hull(18))
    assert (edge_counts(mesh) == 2).all()
    assert n_components(mesh) == 1
    assert np.abs(radii(mesh) - RADIUS).max() < 0.2
    assert radii(mesh).mean() == pytest.approx(RADIUS, abs=0.05)
    assert ((np.asarray(mesh.vertex_normals) * (np.asarray(mesh.vertices) - N / 2)).sum(axis=1) > 0).all()


@pytest.mark.parametrize("ballooning", [0.01, 0.2])
def test_a_hole_in_the_data_of_a_ball_is_closed(ballooning: float) -> None:
    mesh = graph_cut(ball_points(BALL[:, 2] < 0.7), ball_hull(16), ballooning=ballooning)
    assert (edge_counts(mesh) == 2).all()
    assert n_components(mesh) == 1
    height = np.asarray(mesh.vertices)[:, 2] - N / 2
    assert np.abs(radii(mesh) - RADIUS)[height < 0.6 * RADIUS].max() < 0.25
    # Where nothing is known: between the flat lid over the hole and the hull.
    assert height.max() < 16.5
    assert height[height >= 0.6 * RADIUS].min() > 0.6 * RADIUS - 1
    lid = np.array([[N / 2, N / 2, N / 2 + 0.6 * RADIUS]])
    assert is_inside(mesh, lid).all()


def test_more_ballooning_fills_a_hole_up_to_the_hull() -> None:
    flat, full = (
        graph_cut(ball_points(BALL[:, 2] < 0.7), ball_hull(16), ballooning=ballooning) for ballooning in (0.0, 0.5)
    )
    assert flat.get_max_bound()[2] < N / 2 + 0.7 * RADIUS + 1.5
    assert full.get_max_bound()[2] > N / 2 + 15


def test_a_deep_concavity_with_points_survives_ballooning() -> None:
    box = (np.abs(centers() - N / 2) < 15).all(axis=-1)  # from 5 to 35
    low, high = 16.5, 23.5  # a square well, open at z = 35, whose floor lies at 11
    walls = [
        face_points([low, low, 11], [low, high, 35], [1, 0, 0], 1500),
        face_points([high, low, 11], [high, high, 35], [-1, 0, 0], 1500),
        face_points([low, low, 11], [high, low, 35], [0, 1, 0], 1500),
        face_points([low, high, 11], [high, high, 35], [0, -1, 0], 1500),
        face_points([low, low, 11], [high, high, 11], [0, 0, 1], 450),
    ]
    lid = face_points([5, 5, 35], [35, 35, 35], [0, 0, 1], 8000)
    beside = ((lid[:, :2] < low) | (lid[:, :2] > high)).any(axis=1)
    data = np.vstack([*walls, lid[beside]])
    # The other five sides of the block have no points at all: ballooning alone holds them.
    mesh = graph_cut(cloud(data[:, :3], data[:, 3:]), hull_of(box), ballooning=0.1)
    axis = np.column_stack([np.full(25, 20.0), np.full(25, 20.0), np.linspace(12, 36, 25)])
    assert not is_inside(mesh, axis).any()
    behind_walls = np.vstack([axis[:-2] + step for step in ([5, 0, 0], [-5, 0, 0], [0, 5, 0], [0, -5, 0])])
    assert is_inside(mesh, behind_walls).all()
    assert is_inside(mesh, np.array([[20.0, 20.0, 9.5]])).all()
    assert (edge_counts(mesh) == 2).all()


def test_outliers_do_not_tear_the_surface() -> None:
    rng = np.random.default_rng(1)
    n = 2000  # one in eleven
    stray = N / 2 + rng.uniform(0, 17, (n, 1)) * directions(n, 2)
    positions, normals = np.vstack([N / 2 + RADIUS * BALL, stray]), np.vstack([BALL, directions(n, 3)])
    mesh = graph_cut(cloud(positions, normals), ball_hull(18))
    assert (edge_counts(mesh) == 2).all()
    assert n_components(mesh) == 1
    assert np.abs(radii(mesh) - RADIUS).max() < 1
    assert signed_volume(mesh) == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)


@pytest.mark.parametrize("offset", [0.0, 0.3, 0.5, 0.8])
def test_a_plate_two_voxels_thin_is_kept(offset: float) -> None:
    slab = (np.abs(centers()[..., :2] - N / 2) < 15).all(axis=-1) & (np.abs(centers()[..., 2] - N / 2) < 6)
    bottom, top = 19 + offset, 21 + offset
    data = np.vstack(
        [
            face_points([8, 8, top], [32, 32, top], [0, 0, 1], 5000),
            face_points([8, 8, bottom], [32, 32, bottom], [0, 0, -1], 5000),
        ]
    )
    mesh = graph_cut(cloud(data[:, :3], data[:, 3:]), hull_of(slab))
    grid = np.stack(np.meshgrid(np.arange(10, 31), np.arange(10, 31)), axis=-1).reshape(-1, 2)

    def at(z: float) -> NDArray[np.float64]:
        return np.column_stack([grid, np.full(len(grid), z)])

    assert is_inside(mesh, at(20 + offset)).all()
    # Each side to half a voxel.
    assert is_inside(mesh, np.vstack([at(bottom + 0.5), at(top - 0.5)])).all()
    assert not is_inside(mesh, np.vstack([at(bottom - 0.5), at(top + 0.5)])).any()
    assert (edge_counts(mesh) == 2).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_mesh_is_closed_whatever_the_points_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(8, 32, (3000, 3))
    mesh = graph_cut(cloud(positions, directions(3000, seed)), ball_hull(18), ballooning=0.1 * seed, smoothing=0)
    assert (edge_counts(mesh) == 2).all()
    assert mesh.is_edge_manifold(allow_boundary_edges=False)


def test_the_margin_mends_a_hull_that_was_carved_too_deep() -> None:
    hull = ball_hull(RADIUS - 1.5)
    assert np.abs(radii(graph_cut(ball_points(), hull)) - RADIUS).max() < 0.2
    with pytest.raises(EmptyReconstructionError, match="none of 20,000 points"):
        graph_cut(ball_points(), hull, margin=0)


def test_as_many_points_once_more_change_nothing() -> None:
    once = graph_cut(ball_points(), ball_hull(18))
    twice = graph_cut(ball_points(np.tile(np.arange(len(BALL)), 2)), ball_hull(18))
    np.testing.assert_array_equal(np.asarray(once.triangles), np.asarray(twice.triangles))
    np.testing.assert_allclose(np.asarray(once.vertices), np.asarray(twice.vertices), atol=1e-3)


def test_units_and_origin_of_the_world_do_not_matter() -> None:
    hull, points = ball_hull(18), ball_points()
    unit = graph_cut(points, hull)
    far = CarvedVolume.untouched(full_volume((N, N, N), 0.001, (0.3, -0.2, 0.1)))
    far.labels[:] = hull.labels
    positions = 0.001 * (N / 2 + RADIUS * BALL) + [0.3, -0.2, 0.1]
    mesh = graph_cut(cloud(positions, BALL), far)
    moved = 1000 * (np.asarray(mesh.vertices) - [0.3, -0.2, 0.1])
    # Positions come in single precision: 3e-8 of 300 voxels.
    assert moved.mean(axis=0) == pytest.approx(np.asarray(unit.vertices).mean(axis=0), abs=1e-3)
    assert np.linalg.norm(moved - N / 2, axis=1).std() == pytest.approx(radii(unit).std(), abs=1e-3)


def test_without_data_the_surface_follows_the_hulls_distance() -> None:
    hull = ball_hull(16.3)
    exact = (16.3 - np.linalg.norm(centers() - N / 2, axis=-1)).astype(np.float32)
    known = CarvedVolume(hull.volume, hull.labels, hull.degree, hull.n_views, exact)
    ring = np.abs(BALL[:, 2]) < 0.5
    points = cloud(N / 2 + 16.3 * BALL[ring], BALL[ring])
    rough, smooth = (radii(graph_cut(points, h, ballooning=0.5, smoothing=0)) for h in (hull, known))
    assert np.abs(smooth - 16.3).max() < 0.3
    assert np.abs(smooth - 16.3).max() < np.abs(rough - 16.3).max()


def test_points_that_lie_outside_the_hull_are_refused() -> None:
    with pytest.raises(EmptyReconstructionError, match="none of 20,000 points lies in the hull"):
        graph_cut(ball_points().translate(o3d.core.Tensor([60.0, 0, 0])), ball_hull(18))
    with pytest.raises(EmptyReconstructionError, match="none of 0 points"):
        graph_cut(ball_points(slice(0)), ball_hull(18))
    with pytest.raises(EmptyReconstructionError, match="none of 20,000 points"):
        graph_cut(ball_points(), hull_of(np.zeros((N, N, N), np.bool_)))


def test_a_few_points_alone_carry_no_surface() -> None:
    with pytest.raises(EmptyReconstructionError, match="the cut left none of the hull's"):
        graph_cut(ball_points(slice(5)), ball_hull(18), ballooning=0)


@pytest.mark.parametrize("name", ["normals", "confidence"])
def test_missing_attributes_are_named(name: str) -> None:
    points = ball_points()
    del points.point[name]
    with pytest.raises(ValueError, match=f"got no {name}"):
        graph_cut(points, ball_hull(18))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("positions", np.full((20_000, 3), np.nan), "finite positions"),
        ("normals", 2 * BALL, "unit length"),
        ("normals", np.full((20_000, 3), np.nan), "unit length"),
        ("confidence", np.zeros(20_000), r"confidences of points in \(0, 1\]"),
        ("confidence", np.full(20_000, 1.5), r"confidences of points in \(0, 1\]"),
        ("confidence", np.ones((20_000, 2)), r"got \(20000, 3\), .* \(20000, 2\)"),
    ],
)
def test_attributes_out_of_range_are_refused(name: str, value: NDArray[np.float64], message: str) -> None:
    points = ball_points()
    points.point[name] = o3d.core.Tensor.from_numpy(value.astype(np.float32))
    with pytest.raises(ValueError, match=message):
        graph_cut(points, ball_hull(18))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"attraction": -1}, "expected attraction"),
        ({"attraction": np.inf}, "expected attraction"),
        ({"spread": 0}, "expected attraction"),
        ({"margin": -1}, "expected attraction"),
        ({"evidence": 0}, "expected evidence"),
        ({"evidence": 1e6}, "expected evidence"),
        ({"ballooning": np.nan}, "expected evidence"),
        ({"ballooning": -1}, "expected evidence"),
    ],
)
def test_arguments_out_of_range_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        graph_cut(ball_points(), ball_hull(18), **options)  # type: ignore[arg-type]
