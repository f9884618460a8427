"""How far a result may be wrong: what is predicted, and that it says what errors are like."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scenes import ball_mesh, box_mesh, photographs, transformed

import recon3d
from recon3d.datasets import BuiltInScene
from recon3d.datasets.synthetic import Camera
from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.evaluation.distances import distance_to_mesh
from recon3d.io import Checkpoints, read_uncertainty
from recon3d.rendering.orbit import look_at
from recon3d.reporting import save_uncertainty, uncertainty_map
from recon3d.reporting.uncertainty_maps import full_scale
from recon3d.scene.scene import Scene
from recon3d.surface import VertexVisibility
from recon3d.surface.uncertainty import predict_uncertainty, predicted_distance, triangulation

SETTINGS = recon3d.Settings(n_voxels=20_000)


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Checkpoints:
    return Checkpoints(tmp_path_factory.mktemp("stages"))


@pytest.fixture(scope="module")
def result(temple: BuiltInScene, stages: Checkpoints) -> recon3d.Reconstruction:
    return recon3d.reconstruct(temple.scene, SETTINGS, checkpoints=stages)


def straight_down(angles: list[float], distance: float = 10.0) -> Scene:
    """A box's upper side from above, at angles (degrees) to its normal, all in one plane; a footprint of 1/50."""
    K = np.array([[500.0, 0, 31.5], [0, 500.0, 31.5], [0, 0, 1]])
    cameras = []
    for angle in np.radians(angles):
        eye = distance * np.array([np.sin(angle), 0, np.cos(angle)])
        cameras.append(Camera(K, look_at(eye, np.zeros(3), np.array([0.0, 1.0, 0.0])), 64, 64))
    return photographs(box_mesh(0.5, 0.5, 0.01), taken_by=cameras)


def height_error(angles: list[float], distance: float = 10.0) -> float:
    scene = straight_down(angles, distance)
    seen = np.ones((len(angles), 1), np.bool_)
    return float(triangulation(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), scene, seen)[0])


def test_errors_of_pixels_become_depth_by_the_angle_between_the_views() -> None:
    pixel = 10 / 500
    for half in (2.0, 10.0, 30.0):
        # Two views at +-a see the place at +-tan(a) h, each to a pixel over its cosine.
        expected = pixel / np.cos(np.radians(half)) / (np.sqrt(2) * np.tan(np.radians(half)))
        assert height_error([-half, half]) == pytest.approx(expected, rel=1e-9)
    assert height_error([-10, 10], distance=20.0) == pytest.approx(2 * height_error([-10, 10]))
    assert height_error([-10, 10, -10, 10]) == pytest.approx(height_error([-10, 10]) / np.sqrt(2))
    assert height_error([5, 5]) > 1e6
    assert height_error([5]) == np.inf


def test_errors_drawn_as_predicted_lie_within_the_predicted_distance() -> None:
    rng = np.random.default_rng(4)
    uncertainty = rng.uniform(0.1, 2.0, 20_000)
    error = np.abs(uncertainty * rng.standard_normal(len(uncertainty)))
    for share in (0.5, 0.9, 0.99):
        assert predicted_distance(uncertainty, share) == pytest.approx(np.quantile(error, share), rel=0.03)
    assert predicted_distance(np.full(3, 0.2), 0.6827) == pytest.approx(0.2, rel=1e-3)
    assert predicted_distance(np.array([0.2, np.inf])) == pytest.approx(predicted_distance(np.array([0.2])))
    assert predicted_distance(np.array([np.inf])) == np.inf


def test_every_measured_vertex_has_an_uncertainty_and_what_was_filled_none(result: recon3d.Reconstruction) -> None:
    assert result.uncertainty is not None
    np.testing.assert_array_equal(np.isfinite(result.uncertainty), result.support > 0)
    assert (result.uncertainty > 0).all()


def test_errors_lie_within_the_uncertainty_as_often_as_it_says(
    result: recon3d.Reconstruction, temple: BuiltInScene
) -> None:
    measured = result.support > 0
    error = distance_to_mesh(np.asarray(result.mesh.vertices)[measured], temple.ground_truth)
    uncertainty = result.uncertainty[measured]
    # A pixel is a third of a column here: far from the scenes that the constants are of.
    assert 0.5 < np.mean(error <= uncertainty) < 0.9
    assert np.mean(error <= 2 * uncertainty) > 0.75
    # What it calls uncertain is farther off.
    worst = uncertainty > np.quantile(uncertainty, 0.9)
    assert np.median(error[worst]) > 2 * np.median(error[~worst])


def test_uncertainty_is_as_large_in_another_unit_and_place() -> None:
    mesh = ball_mesh()
    scene = photographs(mesh)
    near = np.asarray(mesh.vertices) + np.random.default_rng(1).normal(0, 0.01, (len(mesh.vertices), 3))
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(near))
    mesh.compute_vertex_normals()
    cloud.point.normals = o3d.core.Tensor.from_numpy(np.asarray(mesh.vertex_normals).copy())
    cloud.point.correlation = o3d.core.Tensor.from_numpy(np.full((len(mesh.vertices), 1), 0.8))
    cloud.point.shift = o3d.core.Tensor.from_numpy(np.full((len(mesh.vertices), 1), 0.02))
    visibility = VertexVisibility.of(mesh, scene)
    measured = visibility.n_views > 0
    found = predict_uncertainty(mesh, cloud, scene, visibility, measured)
    shift = np.array([300.0, -20.0, 7.0])
    moved = o3d.geometry.TriangleMesh(mesh).scale(8.0, np.zeros(3)).translate(shift)
    there = cloud.clone()
    there.point.positions = there.point.positions * 8.0 + o3d.core.Tensor.from_numpy(shift)
    there.point.shift = there.point.shift * 8.0
    again = predict_uncertainty(moved, there, transformed(scene, 8.0, shift), visibility, measured)
    np.testing.assert_allclose(again, 8 * found, rtol=1e-6)
    assert np.isinf(found[~measured]).all()


def test_the_summary_tells_the_predicted_accuracy(result: recon3d.Reconstruction, tmp_path: Path) -> None:
    predicted = result.predicted_accuracy()
    assert result.summary()["uncertainty"] == (
        f"90% of the measured surface within {1000 * predicted:.3g} mm, predicted"
    )
    unscaled = replace(result, scene=replace(result.scene, mm_per_unit=None))
    assert unscaled.summary()["uncertainty"].endswith("units (no scale), predicted")
    written = recon3d.save(result, tmp_path, pictures=False)
    np.testing.assert_allclose(read_uncertainty(written["mesh (ply)"]), result.uncertainty, rtol=1e-6)
    assert json.loads(written["figures"].read_text())["mesh"]["predicted_accuracy"] == pytest.approx(predicted)
    nothing = replace(result, uncertainty=np.full(len(result.support), np.inf))
    assert nothing.predicted_accuracy() is None
    assert "uncertainty" not in nothing.summary()


def test_surface_that_is_too_uncertain_is_left_out(
    temple: BuiltInScene, result: recon3d.Reconstruction, stages: Checkpoints
) -> None:
    limit = float(np.median(result.uncertainty[result.support > 0]))

    def within(distance: float) -> recon3d.Reconstruction:
        settings = replace(SETTINGS, meshing=recon3d.Meshing(max_uncertainty=distance))
        return recon3d.reconstruct(temple.scene, settings, checkpoints=stages)

    cut = within(limit)
    assert cut.uncertainty.max() <= limit
    assert (cut.support > 0).all()
    assert 0 < len(cut.mesh.vertices) < 0.6 * np.count_nonzero(result.support)
    with pytest.raises(EmptyReconstructionError, match="none of the surface is as certain as max_uncertainty 1e-09"):
        within(1e-9)


def test_a_mesh_of_voxels_has_no_uncertainty(temple: BuiltInScene) -> None:
    settings = recon3d.Settings(n_voxels=8_000, carving=recon3d.VisualHull())
    result = recon3d.reconstruct(temple.scene, settings)
    assert result.uncertainty is None
    assert result.predicted_accuracy() is None
    assert "uncertainty" not in result.summary()
    limited = recon3d.Meshing(max_uncertainty=0.001)
    with pytest.raises(ArgumentError, match=r"max_uncertainty=0\.001: expected matching"):
        recon3d.Settings(carving=recon3d.VisualHull(), meshing=limited)
    with pytest.raises(ArgumentError, match="expected max_uncertainty to be a number in"):
        recon3d.Meshing(max_uncertainty=0)


def test_colors_tell_uncertain_surface_from_certain_and_grey_what_was_filled() -> None:
    mesh = ball_mesh()
    uncertainty = np.full(len(mesh.vertices), 0.003)
    uncertainty[0], uncertainty[1] = 0.0, np.inf
    colors = np.asarray(uncertainty_map(mesh, uncertainty, 0.003).vertex_colors)
    assert colors[0, 2] > colors[0, 0]  # bluish
    assert colors[2, 0] > 2 * colors[2, 2]  # red
    np.testing.assert_allclose(colors[1], 0.6)
    with pytest.raises(ArgumentError, match="the uncertainty of each of"):
        uncertainty_map(mesh, uncertainty[:3], 0.003)
    with pytest.raises(ArgumentError, match="expected a positive scale"):
        uncertainty_map(mesh, uncertainty, 0.0)


def test_the_scale_holds_most_of_the_measured_surface() -> None:
    assert full_scale(np.append(np.linspace(0, 0.0031, 101), np.inf)) == pytest.approx(0.005)
    assert full_scale(np.full(5, 2e-4)) == pytest.approx(2e-4)
    assert full_scale(np.full(5, 0.07)) == pytest.approx(0.1)
    assert full_scale(np.full(2, np.inf)) == 1


def test_pictures_of_the_uncertainty_are_of_every_view_and_all_around(tmp_path: Path) -> None:
    mesh = ball_mesh()
    scene = photographs(mesh)
    uncertainty = np.where(np.asarray(mesh.vertices)[:, 2] < 0, np.inf, 0.01)
    written = save_uncertainty(mesh, uncertainty, scene, tmp_path, scale=0.02)
    assert written["uncertainty"] == tmp_path / "uncertainty.png"
    picture = np.asarray(o3d.io.read_image(str(written["uncertainty"])))
    seen = {tuple(color) for color in picture[:300].reshape(-1, 3)}
    assert (153, 153, 153) in seen  # what was filled
    assert len(list((tmp_path / "views").glob("*_uncertainty.png"))) == len(scene.views)
