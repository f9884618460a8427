"""Where further photographs would help."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scenes import ORIGIN, ball_mesh, cameras, grain, photographs

import recon3d
from recon3d.datasets.synthetic import photograph, ring, temple_mesh, temple_texture
from recon3d.errors import ArgumentError
from recon3d.evaluation import Coverage, propose_views
from recon3d.evaluation.distances import sample_surface
from recon3d.evaluation.next_views import _Choice, candidate_cameras
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene
from recon3d.surface.sights import Sights


@pytest.fixture(scope="module")
def ball() -> Scene:
    """A ball, photographed from an arc of 60 degrees."""
    return photographs(ball_mesh(), grain, cameras(4, arc=60.0))


@pytest.fixture(scope="module")
def arc() -> list[Camera]:
    """Six cameras on half a ring around the temple."""
    center = temple_mesh().get_axis_aligned_bounding_box().get_center()
    return ring(center, n_views=6, distance=0.6, width=160, height=120, focal=376.0, arc=150.0)


def test_places_are_seen_from_the_side_that_they_face_unless_something_hides_them() -> None:
    mesh = ball_mesh()
    places = np.array([[0.0, 0, 1.01], [0.0, 0, -1.01], [1.01, 0, 0]])
    normals = places / 1.01
    K = np.array([[40.0, 0, 31.5], [0, 40.0, 31.5], [0, 0, 1]])
    above, aside = np.eye(4), np.eye(4)
    above[:3, :3], above[:3, 3] = np.diag([1.0, -1, -1]), [0, 0, 6]  # at (0, 0, 6), looking down
    aside[:3, :3], aside[:3, 3] = [[0, 1, 0], [0, 0, -1], [-1, 0, 0]], [0, 0, 6]  # at (6, 0, 0)
    found = Sights.of([Camera(K, above, 64, 64), Camera(K, aside, 64, 64)], places, normals, RayCaster(mesh), 0.001)
    np.testing.assert_array_equal(found.seen, [[True, False, False], [False, False, True]])
    np.testing.assert_array_equal(found.steep, found.seen)
    np.testing.assert_allclose(found.toward[0, 0], [0, 0, 1], atol=1e-6)
    assert not found.matchable(found, 0).any()  # a view does not measure with itself


def test_candidates_look_at_the_object_from_as_far_as_the_views_and_not_from_below(ball: Scene) -> None:
    candidates = candidate_cameras(ball)
    assert len(candidates) > 50
    middle = ball.bounds.center
    lowest = min((view.center - middle)[2] / np.linalg.norm(view.center - middle) for view in ball.views)
    for camera in candidates:
        center = np.linalg.inv(camera.cam_from_world)[:3, 3]
        distances = np.linalg.norm(ball.centers - middle, axis=1)
        assert np.linalg.norm(center - middle) == pytest.approx(np.median(distances))
        np.testing.assert_allclose(camera.cam_from_world[2, :3], (middle - center) / np.median(distances), atol=1e-9)
        assert np.degrees(np.arcsin((center - middle)[2] / np.median(distances))) > np.degrees(np.arcsin(lowest)) - 10.1


def test_proposals_are_nearly_the_best_of_all_pairs(ball: Scene) -> None:
    mesh = ball_mesh()
    places, owners = sample_surface(mesh, 0.1, np.random.default_rng(0))
    normals, caster = places / np.linalg.norm(places, axis=1, keepdims=True), RayCaster(mesh)
    candidates = candidate_cameras(ball)[::8]
    own = Sights.of([view.calibration for view in ball.views], places, normals, caster, 1e-3)
    there = Sights.of(candidates, places, normals, caster, 1e-3)
    assert len(owners) == len(places)

    def measured(pair: tuple[int, ...]) -> int:
        found = np.zeros(len(places), np.bool_)
        for n in pair:
            for other in range(len(own.seen)):
                found |= own.matchable(there, n)[other]
            for other in pair:
                found |= there.matchable(there, n)[other]
        return int(found.sum())

    chosen = _Choice(own, there).best(2)
    together = measured(tuple(n for n, _ in chosen))
    for index, worth in chosen:
        assert worth == together - measured(tuple(n for n, _ in chosen if n != index))
    assert together >= 0.95 * max(measured(pair) for pair in combinations(range(len(candidates)), 2))


def test_proposals_show_at_least_four_fifths_of_what_the_best_of_fifty_random_choices_shows(arc: list[Camera]) -> None:
    mesh = temple_mesh()
    scene = photograph(mesh, temple_texture, arc, supersampling=1)
    hull = recon3d.reconstruct(scene, recon3d.Settings(n_voxels=20_000, carving=recon3d.VisualHull()))
    found = propose_views(hull.mesh, scene, 3)
    candidates, rng = candidate_cameras(scene), np.random.default_rng(0)
    choices = [rng.choice(len(candidates), 3, replace=False) for _ in range(50)]
    cameras = [*arc, *(view.camera for view in found.proposals), *(candidates[n] for choice in choices for n in choice)]
    places, owners = sample_surface(mesh, 3e-3, np.random.default_rng(1))
    mesh.compute_triangle_normals()
    sights = Sights.of(cameras, places, np.asarray(mesh.triangle_normals)[owners], RayCaster(mesh), 1e-5)

    def seen_by_two(more: list[int]) -> float:
        """Share of the temple's exact surface that two of the arc and some other cameras can measure together."""
        used = [*range(len(arc)), *more]
        part = Sights(sights.seen[used], sights.steep[used], sights.toward[used])
        return float(np.mean(np.any([part.matchable(part, n).any(axis=0) for n in range(len(used))], axis=0)))

    before, first = seen_by_two([]), len(arc)
    gain, *random = (seen_by_two([first + 3 * n, first + 3 * n + 1, first + 3 * n + 2]) - before for n in range(51))
    assert len(found.proposals) == 3
    assert gain >= 0.8 * max(random)
    assert gain > 1.2 * np.median(random)


def test_a_summary_tells_from_where_to_photograph(ball: Scene) -> None:
    mesh = ball_mesh()
    found = propose_views(mesh, ball, 2)
    assert isinstance(found, Coverage)
    told = found.summary()
    assert told["seen by fewer than two views"] == f"{found.hardly_seen:.1%} of the surface"
    first = found.proposals[0]
    assert f"{first.angle:.0f} degrees from {first.nearest}" in str(told["next view 1"])
    np.testing.assert_allclose(first.center + 6.0 * first.direction, ball.bounds.center, atol=0.1)
    assert 0.05 < first.gain <= found.gain < 1
    assert f"{found.gain:.1%} more of the surface" in str(told["with these views"])
    everything = np.ones(len(mesh.vertices), np.int64)
    nothing = propose_views(mesh, ball, 2, support=everything)
    assert nothing.unmeasured == 0
    assert nothing.proposals == ()
    assert "none would help" in str(nothing.summary()["next views"])


def test_what_does_not_fit_the_mesh_is_refused(ball: Scene) -> None:
    with pytest.raises(ArgumentError, match="expected support of"):
        propose_views(ball_mesh(), ball, 1, support=np.ones(3, np.int64))
    with pytest.raises(ArgumentError, match="expected n to be"):
        propose_views(ball_mesh(), ball, 0)


def test_uncertain_surface_counts_as_missing(ball: Scene) -> None:
    mesh = ball_mesh()
    support, uncertainty = np.full(len(mesh.vertices), 3), np.full(len(mesh.vertices), 0.1 * ball.pixel_footprint)
    upper = np.asarray(mesh.vertices)[:, 2] > 0.2
    uncertainty[upper] = 2 * ball.pixel_footprint
    found = propose_views(mesh, ball, 1, support=support, uncertainty=uncertainty)
    assert found.unmeasured == pytest.approx(0.4, abs=0.1)
    assert found.proposals[0].center[2] > 2
    assert np.linalg.norm(found.proposals[0].center - ORIGIN) == pytest.approx(6, abs=0.2)
