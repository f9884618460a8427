from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scenes import box_mesh, rotation
from typer.testing import CliRunner

from recon3d.cli.entry import app
from recon3d.errors import ArgumentError
from recon3d.evaluation.alignment import align
from recon3d.io.geometry import write_geometry
from recon3d.scene.similarity import Similarity


def shape() -> o3d.geometry.TriangleMesh:
    """Nothing like it is seen in a mirror or from another side: three boxes of different size and place."""
    mesh = box_mesh(1.0, 0.7, 0.4) + box_mesh(0.3, 0.3, 0.9).translate((0.3, 0.1, 0.5))
    return mesh + box_mesh(0.2, 0.4, 0.2).translate((-0.45, 0.3, 0.2))


def test_similarity_is_recovered_and_undone() -> None:
    rng = np.random.default_rng(3)
    points, R = rng.standard_normal((9, 3)), rotation(np.array([0.3, -1.2, 0.7]))
    target = 2.5 * points @ R.T + [1, 2, 3]
    found = Similarity.between(points, target)
    assert found.scale == pytest.approx(2.5)
    assert np.allclose(found.R, R)
    assert np.allclose(found(points), target)
    assert np.allclose(found.inverse()(target), points)
    assert np.allclose(np.column_stack([points, np.ones(9)]) @ found.matrix().T, np.column_stack([target, np.ones(9)]))
    assert Similarity.between(points, target, scaling=False).scale == 1
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(np.array([0.1, 0.4, -0.2])), [0.3, -0.2, 4]
    moved = found.camera(pose)
    before, after = points @ pose[:3, :3].T + pose[:3, 3], target @ moved[:3, :3].T + moved[:3, 3]
    assert np.allclose(after, 2.5 * before)  # in the same directions


@pytest.mark.parametrize("scaling", [False, True])
def test_a_shape_is_brought_back_from_anywhere(scaling: bool) -> None:
    scale = 0.37 if scaling else 1.0
    away = Similarity(scale, rotation(np.array([0.4, 2.0, -1.1])), np.array([3.0, -1.0, 0.5]))
    found = align(shape().transform(away.matrix()), shape(), scaling=scaling)
    corners = np.asarray(shape().vertices)
    assert np.abs(found(away(corners)) - corners).max() < 0.01


def test_a_part_without_counterpart_does_not_pull() -> None:
    """A stand below the reconstruction, of a tenth of its surface."""
    away = Similarity(1.2, rotation(np.array([0.0, 0.1, 0.05])), np.array([0.02, 0.0, -0.03]))
    with_stand = shape() + box_mesh(0.6, 0.4, 0.05).translate((0, 0, -0.4))
    found = align(with_stand.transform(away.matrix()), shape(), scaling=True, start=away.inverse())
    corners = np.asarray(shape().vertices)
    assert np.abs(found(away(corners)) - corners).max() < 0.01


def test_evaluate_measures_what_it_has_aligned(tmp_path: Path) -> None:
    away = Similarity(0.4, rotation(np.array([0.3, -0.2, 0.4])), np.array([1.0, 0.0, 2.0]))
    points = shape().sample_points_uniformly(4000)
    truth = write_geometry(tmp_path / "truth.ply", points)
    moved = write_geometry(tmp_path / "moved.ply", points.transform(away.matrix()))
    command = ["evaluate", str(moved), str(truth), "-o", str(tmp_path / "out"), "--mm-per-unit", "100"]
    told = CliRunner().invoke(app, [*command, "--align", "similarity"], catch_exceptions=False).output
    assert float(told.split("scale ")[1].split(",")[0]) == pytest.approx(2.5, rel=1e-3)
    figures = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert figures["accuracy_mm"] < 0.1  # of 100
    assert (tmp_path / "out" / "aligned.ply").is_file()
    with pytest.raises(ArgumentError, match="--cameras: expected --align"):
        CliRunner().invoke(app, [*command, "--cameras", "little-temple"], catch_exceptions=False)
