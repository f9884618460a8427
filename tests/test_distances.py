from __future__ import annotations

import json

import numpy as np
import open3d as o3d
import pytest
from exact import distance_to_triangle, exact_distances
from numpy.typing import NDArray
from scenes import ball_mesh, ball_volume, box_mesh, full_volume

from recon3d.evaluation.distances import (
    MEASURED_SHARE,
    Evaluation,
    distance_to_mesh,
    evaluate,
    measure,
    sample_surface,
    triangles_near,
)


def plate(size: float = 1.0, height: float = 0.0) -> o3d.geometry.TriangleMesh:
    """Square of two triangles in the plane z = height, its lowest corner at x = y = 0."""
    corners = np.array([[0, 0, height], [size, 0, height], [size, size, height], [0, size, height]], float)
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(corners), o3d.utility.Vector3iVector(np.array([[0, 1, 2], [0, 2, 3]]))
    )


def sphere(radius: float) -> o3d.geometry.TriangleMesh:
    """Sphere within 0.1% of its radius: the facets' sagitta is 1 - cos(pi / 2 / 60) = 0.03%, twice."""
    return ball_mesh(radius, 60)


def cloud(points: NDArray[np.float64]) -> o3d.geometry.PointCloud:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def test_distances_to_a_mesh_are_those_of_the_nearest_triangle() -> None:
    mesh = ball_mesh(1.0, 5) + box_mesh(0.5, 3.0, 0.2)
    points = np.random.default_rng(0).uniform(-2, 2, (150, 3))
    # Ray casting works in single precision.
    np.testing.assert_allclose(distance_to_mesh(points, mesh), exact_distances(points, mesh), rtol=0, atol=2e-6)


def test_distances_are_to_triangles_however_far_apart_the_samples_lie() -> None:
    truth = ball_mesh(1.0, 6)
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (200, 3))
    exact = np.sort(exact_distances(points, truth))
    result = evaluate(cloud(points), truth, mm_per_unit=1.0, spacing=0.5)
    # A distance that is right to 1% has its rank's right to 1% too.
    np.testing.assert_allclose(result.accuracy_distances, exact, rtol=0.01)


def test_a_part_of_a_mesh_is_measured_as_if_it_were_alone() -> None:
    truth, ball, box = sphere(1.0), ball_mesh(1.01, 9), box_mesh(0.2, 0.5, 0.5).translate((1.2, 0, 0))
    n_ball = len(ball.triangles)
    whole = ball + box
    part = np.arange(len(whole.triangles)) < n_ball
    upper = np.asarray(whole.vertices)[np.asarray(whole.triangles)][..., 2].min(axis=1) >= 0
    for chosen in (part, part & upper):
        found = measure(whole, truth, spacing=0.05).of_part(whole, chosen)
        alone = o3d.geometry.TriangleMesh(whole)
        alone.remove_triangles_by_mask(~chosen)
        np.testing.assert_allclose(found.to_r, exact_distances(found.samples_g, alone), rtol=0.01)
        assert chosen[found.owners].all()
        assert chosen[found.nearest].all()
        assert len(found.to_g) == pytest.approx(alone.get_surface_area() / 0.05**2 / MEASURED_SHARE, rel=0.02)
        assert found.evaluation(1.0).accuracy_mm == pytest.approx(
            evaluate(alone, truth, mm_per_unit=1.0, spacing=0.05).accuracy_mm, rel=0.1
        )


@pytest.mark.parametrize("shift", [0.001, 0.02, 0.3])
def test_both_directions_between_meshes_are_exact(shift: float) -> None:
    truth, moved = sphere(1.0), ball_mesh(1.0, 9).translate((shift, 0, 0))
    result = evaluate(moved, truth, mm_per_unit=1.0, spacing=0.05)
    rng = np.random.default_rng(0)
    of_truth, of_moved = (sample_surface(mesh, 0.05, rng)[0][::MEASURED_SHARE] for mesh in (truth, moved))
    for got, exact in (
        (result.accuracy_distances, distance_to_mesh(of_moved, truth)),
        (result.completeness_distances, distance_to_mesh(of_truth, moved)),
    ):
        np.testing.assert_allclose(got, np.sort(exact), rtol=0.01, atol=4e-6)


def test_concentric_spheres_are_their_difference_of_radii_apart() -> None:
    result = evaluate(sphere(1.02), sphere(1.0), mm_per_unit=100.0, completeness_threshold_mm=2.5, spacing=0.005)
    # 2 mm, of which the facets take 0.1 mm at most, and the tolerance is 1%.
    assert result.accuracy_mm == pytest.approx(2.0, abs=0.12)
    assert result.accuracy_at(50) == pytest.approx(2.0, abs=0.12)
    assert result.completeness_percent == 100.0
    assert result.completeness_at(1.85) == 0.0


def test_a_shifted_plane_is_its_shift_away() -> None:
    result = evaluate(plate(1.0, 0.01), plate(), spacing=0.002)
    assert result.accuracy_mm == pytest.approx(10.0, rel=1e-9)
    assert result.completeness_at(9.99) == 0.0
    assert result.completeness_at(10.01) == 100.0


def test_half_a_plane_is_half_complete_but_accurate() -> None:
    half = plate().crop(o3d.geometry.AxisAlignedBoundingBox([-1, -1, -1], [2, 2, 1]))
    half.vertices = o3d.utility.Vector3dVector(np.asarray(half.vertices) * [0.5, 1, 1])
    result = evaluate(half, plate(), mm_per_unit=100.0, completeness_threshold_mm=1.0, spacing=0.004)
    # Half of the square, one hundredth of its side around, less sampling noise.
    assert result.completeness_percent == pytest.approx(51.0, abs=1.0)
    assert result.accuracy_mm == pytest.approx(0.0, abs=1e-9)
    back = evaluate(plate(), half, mm_per_unit=100.0, completeness_threshold_mm=1.0, spacing=0.004)
    assert back.completeness_percent > 99
    assert back.accuracy_mm == pytest.approx(40.0, abs=1.0)  # 90% of the square lies within 0.4 of the half


def test_the_same_seed_gives_the_same_figures_and_another_one_does_not() -> None:
    first, again, other = (evaluate(sphere(1.05), sphere(1.0), spacing=0.05, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.accuracy_distances, again.accuracy_distances)
    np.testing.assert_array_equal(first.completeness_distances, again.completeness_distances)
    assert (first.accuracy_distances != other.accuracy_distances).any()


def test_identical_shapes_are_no_distance_apart() -> None:
    result = evaluate(sphere(1.0), sphere(1.0), mm_per_unit=1.0, spacing=0.02)
    assert result.accuracy_at(100) < 1e-9
    assert result.completeness_at(1e-9) == 100.0


def test_spacing_is_a_thousandth_of_the_diagonal_unless_given() -> None:
    result = evaluate(plate(), plate(), mm_per_unit=1.0)
    # An area of one over the square of 0.001 * sqrt(2).
    # Every fourth sample of a mesh is measured.
    assert len(result.completeness_distances) == 500_000 / MEASURED_SHARE
    assert len(evaluate(plate(), plate(), spacing=0.1).accuracy_distances) == 100 / MEASURED_SHARE


DISTANCES = np.arange(1.0, 11.0)  # ten distances, 1 to 10 mm


@pytest.mark.parametrize(
    ("percent", "expected"), [(90, 9.0), (100, 10.0), (50, 5.0), (51, 6.0), (10, 1.0), (0.1, 1.0), (99, 10.0)]
)
def test_accuracy_is_the_distance_that_a_percentage_keeps(percent: float, expected: float) -> None:
    assert Evaluation(DISTANCES, DISTANCES, percent).accuracy_mm == expected
    assert Evaluation(DISTANCES, DISTANCES).accuracy_at(percent) == expected


@pytest.mark.parametrize(("threshold", "expected"), [(0.5, 0.0), (1.0, 10.0), (4.99, 40.0), (5.0, 50.0), (99.0, 100.0)])
def test_completeness_is_the_percentage_within_a_distance(threshold: float, expected: float) -> None:
    assert Evaluation(DISTANCES, DISTANCES, 90, threshold).completeness_percent == expected


def test_the_curves_are_the_cumulative_distributions() -> None:
    curves = Evaluation(DISTANCES, 2 * DISTANCES).curves(50)
    distance = np.array(curves["distance_mm"])
    assert len(distance) == 50
    assert distance[0] == 0
    for n, x in enumerate(distance):
        assert curves["reconstruction_within_percent"][n] == 10 * np.count_nonzero(x >= DISTANCES)
        assert curves["ground_truth_within_percent"][n] == 10 * np.count_nonzero(x >= 2 * DISTANCES)


def test_the_record_and_the_summary_tell_the_figures() -> None:
    result = Evaluation(DISTANCES, DISTANCES, 80, 2.0, left_out=7)
    record = json.loads(json.dumps(result.record()))
    assert record["accuracy_mm"] == 8.0
    assert record["completeness_percent"] == 20.0
    assert record["median_mm"] == 5.0
    assert record["mean_reconstruction_to_ground_truth_mm"] == 5.5
    assert record["samples_left_out"] == 7
    assert record["ground_truth_samples"] == 10
    assert result.summary()["accuracy (80% of R)"] == "8 mm"
    assert result.summary()["completeness (2 mm)"] == "20.0%"
    assert "20.0%" in result._repr_html_()


def test_filler_is_neither_asked_for_nor_held_against_the_reconstruction() -> None:
    # The truth is a plate of 1 x 1 and, apart from it, a filler plate; the reconstruction has a part near the filler.
    filler = plate().translate((3.0, 0, 0))
    truth = plate() + filler
    valid = np.array([True, True, False, False])
    wrong = plate(1.0, 0.2).translate((3.0, 0, 0))
    reconstruction = plate() + wrong
    result = evaluate(reconstruction, truth, valid=valid, mm_per_unit=1.0, completeness_threshold_mm=0.1, spacing=0.02)
    assert result.completeness_percent == 100.0
    assert result.accuracy_at(100) < 1e-9
    assert result.left_out == 2500 / MEASURED_SHARE  # the samples of the wrong plate
    strict = evaluate(reconstruction, truth, mm_per_unit=1.0, completeness_threshold_mm=0.1, spacing=0.02)
    assert strict.accuracy_mm == pytest.approx(0.2, rel=1e-9)
    assert strict.completeness_percent == pytest.approx(50, abs=0.1)
    assert strict.left_out == 0


def test_filler_that_no_sample_lies_on_still_counts_as_filler() -> None:
    truth = plate() + plate(1e-3, 0.1)
    above = cloud(np.array([[5e-4, 5e-4, 0.12], [0.5, 0.5, 0.12]]))
    result = evaluate(above, truth, valid=np.array([True, True, False, False]), mm_per_unit=1.0, spacing=0.1)
    np.testing.assert_allclose(result.accuracy_distances, [0.12], rtol=0.01)
    assert result.left_out == 1


def test_triangles_near_data_are_the_real_ones() -> None:
    truth = plate() + plate().translate((3.0, 0, 0))
    assert triangles_near(truth, plate(1.0, 0.05), 0.1).tolist() == [True, True, False, False]


def test_a_point_cloud_may_be_the_truth_and_have_filler() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    result = evaluate(
        cloud(points + np.array([0, 0.1, 0])),
        cloud(points),
        valid=np.array([True, True, False]),
        mm_per_unit=1.0,
        spacing=1.0,
    )
    np.testing.assert_allclose(result.accuracy_distances, [0.1, 0.1])
    np.testing.assert_allclose(result.completeness_distances, [0.1, 0.1])
    assert result.left_out == 1


@pytest.mark.parametrize("kind", ["mesh", "cloud", "voxel grid", "carving volume"])
def test_every_kind_of_shape_is_measured(kind: str) -> None:
    volume = ball_volume(1.0, 40)
    shape = {
        "mesh": sphere(1.0),
        "cloud": sphere(1.0).sample_points_uniformly(3000),
        "voxel grid": volume.to_voxel_grid(),
        "carving volume": volume,
    }[kind]
    result = evaluate(shape, sphere(1.0), mm_per_unit=1.0, completeness_threshold_mm=0.1, spacing=0.02)
    # Centres of surface voxels lie inside the sphere, by less than a voxel's diagonal.
    assert result.accuracy_at(100) < volume.voxel_size * np.sqrt(3) + 0.02
    assert result.completeness_percent > 99


def test_a_voxel_grid_and_the_volume_it_came_from_are_measured_alike() -> None:
    volume = ball_volume(1.0, 20)
    a, b = (evaluate(shape, sphere(1.0), spacing=0.05) for shape in (volume, volume.to_voxel_grid()))
    np.testing.assert_allclose(a.accuracy_distances, b.accuracy_distances, atol=1e-9)


def test_mesh_samples_lie_on_their_triangles_evenly() -> None:
    mesh = box_mesh(1.0, 2.0, 0.5)
    points, owner = sample_surface(mesh, 0.02, np.random.default_rng(0))
    # The surface is 2 * (2 + 0.5 + 1).
    assert len(points) == len(owner) == round(7 / 0.02**2)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    # Strata along the cumulated area: each triangle's share is exact but for its two ends.
    np.testing.assert_allclose(np.bincount(owner, minlength=12), area / 0.02**2, atol=2)
    for index in range(12):
        mine = points[owner == index][:40]
        assert max(distance_to_triangle(point, *corners[index]) for point in mine) < 1e-12
        # Uniform over a triangle: the mean is the centroid, within five standard errors (about 0.24 / sqrt(n) sides).
        side = np.ptp(corners[index], axis=0).max()
        offset = np.abs(points[owner == index].mean(axis=0) - corners[index].mean(axis=0)).max()
        assert offset < 5 * 0.24 * side / np.sqrt((owner == index).sum())


def test_a_tiny_mesh_gets_one_sample() -> None:
    assert len(sample_surface(plate(1e-6), 1.0, np.random.default_rng(0))[0]) == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"accuracy_percent": 0}, r"expected an accuracy percentage in \(0, 100\], got 0"),
        ({"accuracy_percent": 101}, r"expected an accuracy percentage in \(0, 100\], got 101"),
        ({"completeness_threshold_mm": 0}, "expected a positive completeness threshold"),
        ({"mm_per_unit": -1}, "expected a positive completeness threshold and mm_per_unit"),
        ({"valid": np.ones(3, np.bool_)}, r"expected a bool mask \(2,\) with a True in it, got \(3,\) bool"),
        ({"valid": np.zeros(2, np.bool_)}, "with a True in it"),
        ({"valid": np.ones(2)}, "float64"),
    ],
)
def test_senseless_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        evaluate(plate(), plate(), spacing=0.1, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("spacing", [0.0, -0.1, float("nan")])
def test_a_senseless_spacing_is_refused(spacing: float) -> None:
    with pytest.raises(ValueError, match="spacing"):
        evaluate(plate(), plate(), spacing=spacing)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (o3d.geometry.PointCloud(), "the PointCloud to evaluate is empty"),
        (o3d.geometry.TriangleMesh(), "the mesh to evaluate has no triangles"),
        (
            full_volume((2, 2, 2)).with_occupancy(np.zeros((2, 2, 2), np.bool_)),
            "the CarvingVolume to evaluate is empty",
        ),
    ],
)
def test_empty_shapes_are_refused(shape: o3d.geometry.PointCloud, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        evaluate(shape, plate(), spacing=0.1)


@pytest.mark.parametrize("truth", [o3d.geometry.PointCloud(), o3d.geometry.TriangleMesh()])
def test_an_empty_truth_is_refused(truth: o3d.geometry.PointCloud) -> None:
    with pytest.raises(ValueError, match="to evaluate"):
        evaluate(plate(), truth)


def test_a_reconstruction_near_filler_alone_is_refused() -> None:
    truth = plate() + plate().translate((50.0, 0, 0))
    with pytest.raises(ValueError, match="every sample of the reconstruction lies nearest to filler"):
        evaluate(plate().translate((50.0, 0, 0)), truth, valid=np.array([True, True, False, False]), spacing=0.1)
