from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes import cameras, photographs, plain
from sfm_world import blocks, taken, world

from recon3d.calibration import refine_cameras
from recon3d.datasets.synthetic import photograph
from recon3d.errors import CalibrationError, DataError
from recon3d.io.refined_cameras import with_refined_cameras, write_refined_cameras
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

pytest.importorskip("pycolmap")


def shaken(scene: Scene, degrees: float, seed: int = 0) -> list[View]:
    """Views whose cameras are turned by a random angle and shifted accordingly."""
    rng, views = np.random.default_rng(seed), []
    for view in scene.views:
        pose = view.cam_from_world
        turn = cv2.Rodrigues(np.radians(degrees) * rng.standard_normal(3))[0]
        pose[:3, :3] = turn @ pose[:3, :3]
        pose[:3, 3] += 5.0 * np.radians(degrees) * rng.standard_normal(3)
        views.append(View.from_matrices(view.K, pose, view.image, silhouette=view.silhouette, name=view.name))
    return views


def test_shaken_cameras_are_brought_back(sfm_scene: Scene) -> None:
    given = shaken(sfm_scene, 0.15)
    refined = refine_cameras(given)

    def pixel_error(views: Sequence[View]) -> float:
        """Root mean square in the photographs, of the box's corners after the best similarity of the centres."""
        corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-0.8, 0.8) for z in (-0.6, 0.6)])
        rows = []
        for corner in corners:
            system = []
            for view, true in zip(views, sfm_scene.views, strict=True):
                (u, v), P = true.project(corner[None])[0][0], view.projection
                system += [u * P[2] - P[0], v * P[2] - P[1]]
            point = np.linalg.svd(np.array(system))[2][-1]
            rows.append(point[:3] / point[3])
        shifts = [
            view.project(np.array(rows))[0] - true.project(corners)[0]
            for view, true in zip(views, sfm_scene.views, strict=True)
        ]
        return float(np.sqrt(np.mean(np.square(shifts))))

    assert refined.residual_after < 0.5 < refined.residual_before
    assert pixel_error(refined.views) < 0.25 * pixel_error(given)
    assert "residual after (pixels)" in refined.summary()
    assert [view.name for view in refined.views] == [view.name for view in sfm_scene.views]


def test_right_cameras_stay_with_their_frame_scale_and_skew() -> None:
    """Cameras with skew and unequal focal lengths, whose residuals are those of the features."""
    scene = photographs(world(), blocks, cameras(8, arc=90, width=240, height=180))
    refined = refine_cameras(scene.views, focal_lengths=True)
    assert refined.moved.max() < 0.5
    for view, true in zip(refined.views, scene.views, strict=True):
        assert view.K[0, 1] / view.K[0, 0] == pytest.approx(true.K[0, 1] / true.K[0, 0])
        assert view.K[0, 0] / view.K[1, 1] == pytest.approx(true.K[0, 0] / true.K[1, 1])
        assert view.K[0, 0] == pytest.approx(true.K[0, 0], rel=0.02)
        assert np.linalg.norm(view.center - true.center) < 0.02 * 6.0


def test_views_without_matches_cannot_be_refined(sfm_scene: Scene) -> None:
    with pytest.raises(ValueError, match="at least 3 views"):
        refine_cameras(sfm_scene.views[:2])
    with pytest.raises(CalibrationError, match="too little texture"):
        refine_cameras(photograph(world(), plain, taken(4)).views)


def test_refined_cameras_are_kept_for_the_scene_that_they_are_of(tmp_path: Path) -> None:
    scene = photographs(world(), blocks, cameras(3, arc=30))
    moved = replace(scene, views=tuple(shaken(scene, 0.5)))
    assert with_refined_cameras(tmp_path, scene) is None
    file = write_refined_cameras(tmp_path, moved, scene)
    kept = with_refined_cameras(tmp_path, scene)
    assert kept is not None
    assert [view.calibration for view in kept.views] == [view.calibration for view in moved.views]
    assert with_refined_cameras(tmp_path, moved) is None
    assert with_refined_cameras(tmp_path, moved, of_views=False) is not None
    file.write_text('{"of": 1, "cameras": {}}')
    with pytest.raises(DataError, match=r"cameras\.json: expected a camera for each view"):
        with_refined_cameras(tmp_path, scene, of_views=False)
