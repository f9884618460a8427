from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from recon3d.calibration.turntable import turntable_cameras
from recon3d.datasets import little_temple
from recon3d.diagnosis import Finding, check_scene, diagnose
from recon3d.diagnosis import matches as diagnosis_matches
from recon3d.diagnosis.epipolar import Cameras
from recon3d.diagnosis.figure import save_figure
from recon3d.diagnosis.half_pixel import half_pixel_findings
from recon3d.diagnosis.hypotheses import reordered
from recon3d.diagnosis.matches import Matches, Picture
from recon3d.diagnosis.order import assigned
from recon3d.io import open_scene
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import NO_SILHOUETTES, Scene
from recon3d.scene.view import View

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

Pose = NDArray[np.float64]
Intrinsics = NDArray[np.float64]


@pytest.fixture(scope="module", autouse=True)
def features_once() -> Iterator[None]:
    """Features of a photograph, and matches of two, are found once, for all scenes whose cameras alone are broken."""
    found: dict[object, Picture] = {}
    trusted: dict[object, NDArray[np.float64] | None] = {}
    kept: list[Picture] = []
    find, match = Picture.of, diagnosis_matches._trusted

    def of(view: View) -> Picture:
        if view.mask is not None:
            return find(view)
        key = view.photograph
        if key not in found:
            found[key] = find(view)
        size = found[key].camera.width / view.width
        return replace(found[key], view=view, camera=view.calibration.at(size))

    def matched(a: Picture, b: Picture) -> NDArray[np.float64] | None:
        key = (id(a.descriptors), id(b.descriptors))
        if key not in trusted:
            trusted[key] = match(a, b)
            kept.extend((a, b))  # or another array might get the number of one that is gone
        return trusted[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Picture, "of", of)
        patch.setattr(diagnosis_matches, "_trusted", matched)
        yield


@pytest.fixture(scope="module")
def scene(sfm_scene: Scene) -> Scene:
    """A box on a plate, without masks, from an arc of twelve cameras at unequal steps."""
    made = sfm_scene
    views = [replace(view, mask=None) for n, view in enumerate(made.views) if n != 3]
    return replace(made, views=tuple(views), bounds=made.bounds.padded(0.2))


def posed(scene: Scene, change: Callable[[Pose], Pose]) -> Scene:
    return of_views(scene, [View.from_matrices(v.K, change(v.cam_from_world), v.photograph, name=v.name)
                            for v in scene.views])  # fmt: skip


def of_intrinsics(scene: Scene, change: Callable[[Intrinsics, View], Intrinsics]) -> Scene:
    return of_views(scene, [View.from_matrices(change(v.K, v), v.cam_from_world, v.photograph, name=v.name)
                            for v in scene.views])  # fmt: skip


def with_images(scene: Scene, change: Callable[[int, NDArray[np.uint8]], NDArray[np.uint8]]) -> Scene:
    views = [replace(v, photograph=np.ascontiguousarray(change(n, v.image))) for n, v in enumerate(scene.views)]
    return replace(scene, views=tuple(views))


def ordered(scene: Scene, order: Sequence[int] | NDArray[np.int64]) -> Scene:
    """Photograph n with the camera of view order[n]."""
    views = [replace(v, calibration=scene.views[k].calibration) for v, k in zip(scene.views, order, strict=True)]
    return of_views(scene, views)


def of_views(scene: Scene, views: Sequence[View]) -> Scene:
    """The scene with other views, and bounds that the first one sees."""
    seen = views[0].center + 5 * views[0].cam_from_world[2, :3]
    return replace(scene, views=tuple(views), bounds=Bounds(seen - 0.5, seen + 0.5))


def only(scene: Scene) -> Finding:
    (finding,) = check_scene(scene)
    return finding


def with_t(pose: Pose, t: NDArray[np.float64]) -> Pose:
    changed = pose.copy()
    changed[:3, 3] = t
    return changed


def transposed(pose: Pose) -> Pose:
    changed = pose.copy()
    changed[:3, :3] = pose[:3, :3].T
    return changed


def test_a_good_scene_gives_no_alarm(scene: Scene) -> None:
    diagnosis = diagnose(scene)
    assert diagnosis.findings == ()
    assert len(diagnosis.points) > 300  # so the matches have spoken


def test_photographs_without_texture_say_nothing_about_the_cameras(scene: Scene) -> None:
    grey = with_images(scene, lambda n, image: np.full_like(image, 60 + 8 * n))
    assert {finding.kind for finding in check_scene(posed(grey, np.linalg.inv))} <= {"cameras inside the box"}
    without_masks = replace(grey, notes={NO_SILHOUETTES: "the background has many colors"})
    assert [finding.kind for finding in check_scene(without_masks)] == ["neither masks nor matches"]


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("opengl axes", lambda pose: OPENGL @ pose),
        ("camera to world", np.linalg.inv),
        ("camera to world, opengl axes", lambda pose: np.linalg.inv(OPENGL @ pose)),
        ("R transposed", transposed),
        ("t is the centre", lambda pose: with_t(pose, -pose[:3, :3].T @ pose[:3, 3])),
        ("t negated", lambda pose: with_t(pose, -pose[:3, 3])),
    ],
)
def test_wrong_poses_are_named(scene: Scene, kind: str, change: Callable[[Pose], Pose]) -> None:
    assert only(posed(scene, change)).kind == kind


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("K normalised", lambda K, view: np.diag([1 / view.width, 1 / view.height, 1]) @ K),
        ("K of another size", lambda K, _: np.diag([2, 2, 1]) @ K),
        ("K of another size", lambda K, _: np.diag([0.25, 0.25, 1]) @ K),
        ("principal point", lambda K, _: K * [[1, 1, 0], [1, 1, 0], [1, 1, 1]]),
    ],
)
def test_wrong_intrinsics_are_named(scene: Scene, kind: str, change: Callable[[Intrinsics, View], Intrinsics]) -> None:
    assert only(of_intrinsics(scene, change)).kind == kind


def test_photographs_in_another_order_than_the_cameras_are_told(scene: Scene) -> None:
    n = len(scene.views)
    assert only(ordered(scene, np.arange(n)[::-1])).kind == "images reversed"
    shifted = only(ordered(scene, np.roll(np.arange(n), 2)))
    assert (shifted.kind, f"needs the camera of {scene.views[2].name}" in shifted.message) == ("images shifted", True)
    by_text = sorted(range(n), key=lambda k: str(k + 1))
    assert only(ordered(scene, by_text)).kind == "images in another order"


def test_two_exchanged_views_are_named(scene: Scene) -> None:
    order = np.arange(len(scene.views))
    order[[2, 6]] = 6, 2
    finding = only(ordered(scene, order))
    assert (finding.kind, finding.views) == ("views exchanged", (scene.views[2].name, scene.views[6].name))


def test_one_wrong_camera_is_named(scene: Scene) -> None:
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.array([0.05, 0.02, 0.03]))[0]
    views = list(scene.views)
    views[5] = View.from_matrices(views[5].K, turn @ views[5].cam_from_world, views[5].photograph, name=views[5].name)
    finding = only(replace(scene, views=tuple(views)))
    assert (finding.kind, finding.views) == ("one wrong camera", (views[5].name,))
    assert views[5].name in finding.message


def test_a_camera_at_a_wrong_angle_of_the_ring_is_named(scene: Scene) -> None:
    """Four degrees about the object, which it still looks at: no more than a few pixels from its epipolar lines."""
    about = np.eye(4)
    about[:3, :3] = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(4)]))[0]
    views = list(scene.views)
    views[7] = View.from_matrices(views[7].K, views[7].cam_from_world @ about, views[7].photograph, name=views[7].name)
    finding = only(replace(scene, views=tuple(views)))
    assert (finding.kind, finding.views) == ("one wrong camera", (views[7].name,))


def matched_ring(n: int, n_points: int) -> tuple[Matches, Cameras]:
    """Matches, to 0.2 pixels, between each of n photographs and the next two, and their cameras at unequal steps."""
    rng = np.random.default_rng(3)
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    taken_by = turntable_cameras(K, np.cumsum(rng.uniform(6, 18, n)), 3.0, 1.0, 18.0)
    poses = np.array([camera.cam_from_world for camera in taken_by])
    points = np.column_stack([rng.uniform(-0.5, 0.5, (n_points, 3)), np.ones(n_points)])
    homogeneous = np.einsum("ij,njk,pk->npi", K, poses[:, :3], points)
    places = homogeneous[..., :2] / homogeneous[..., 2:] + rng.normal(0, 0.2, (n, n_points, 2))
    pairs = np.array(sorted((min(a, b), max(a, b)) for a in range(n) for b in ((a + 1) % n, (a + 2) % n)))
    both = np.concatenate([np.stack([places[a], places[b]], axis=1) for a, b in pairs])
    cameras = Cameras(
        np.tile(K, (n, 1, 1)), poses, np.tile([640.0, 480.0], (n, 1)), np.tile(np.diag([0.75, 0.75, 1.0]), (n, 1, 1))
    )
    cameras.reduced[:, :2, 2] = (0.75 - 1) / 2
    return Matches(pairs, np.repeat(np.arange(len(pairs)), n_points), 0.75 * both + (0.75 - 1) / 2), cameras


def test_half_a_pixel_is_told() -> None:
    matches, right = matched_ring(12, 400)
    assert half_pixel_findings(matches, right) == []
    for sign, advice in ((1, "Subtract 0.5 from cx and cy."), (-1, "Add 0.5 to cx and cy.")):
        K = right.K.copy()
        K[:, :2, 2] += 0.5 * sign
        (finding,) = half_pixel_findings(matches, right._replace(K=K))
        assert (finding.kind, finding.advice) == ("half pixel", advice)
        K[:, 0, 2] -= sign  # off in one direction and the other: that is no convention
        assert half_pixel_findings(matches, right._replace(K=K)) == []


def test_any_order_of_many_photographs_is_found() -> None:
    matches, right = matched_ring(20, 24)
    shuffled = np.random.default_rng(0).permutation(20)
    order = assigned(matches, reordered(right, shuffled))
    np.testing.assert_array_equal(shuffled[order], np.arange(20))


def test_a_turntable_that_turned_the_other_way_is_told(scene: Scene) -> None:
    first = scene.views[0].cam_from_world
    turned = only(posed(scene, lambda pose: first @ np.linalg.inv(pose) @ first))
    assert turned.kind == "turntable reversed"
    assert "mirrored" in turned.message  # which is the same where the cameras look at the axis


def test_mirrored_and_turned_photographs_are_told(scene: Scene) -> None:
    assert "mirrored" in only(with_images(scene, lambda _, image: image[:, ::-1])).message
    assert only(with_images(scene, lambda _, image: image[::-1])).kind == "rows from below"
    assert only(with_images(scene, lambda _, image: image[::-1, ::-1])).kind == "photographs turned"


def test_wrong_bounds_are_told(scene: Scene) -> None:
    low, high, center = np.array(scene.bounds.low), np.array(scene.bounds.high), scene.bounds.center
    tiny = only(replace(scene, bounds=Bounds(low / 1000, high / 1000)))
    assert (tiny.kind, "1000 times too small" in tiny.message) == ("unit", True)
    assert only(replace(scene, bounds=scene.bounds.padded(25))).kind == "huge box"
    point = center + np.array([0.0, 0.0, 0.3])
    assert only(replace(scene, bounds=Bounds(point - 0.05, point + 0.05))).kind == "tiny box"
    corner = np.array([1.4, 1.4, 0.3])
    assert only(replace(scene, bounds=Bounds(corner - 0.5, corner + 0.5))).kind == "wrong box"


def test_cameras_inside_the_bounds_are_mentioned(scene: Scene) -> None:
    inside = only(replace(scene, bounds=scene.bounds.padded(5.0)))
    assert (inside.kind, len(inside.views)) == ("cameras inside the box", len(scene.views))


def test_a_duplicate_is_named(scene: Scene) -> None:
    twin = replace(scene.views[4], name="twin")
    finding = only(replace(scene, views=(*scene.views, twin)))
    assert (finding.kind, finding.views) == ("duplicate views", (scene.views[4].name, "twin"))


def test_other_exposure_and_white_balance_are_named(scene: Scene) -> None:
    darker = only(with_images(scene, lambda n, image: (image * (0.55 if n == 6 else 1.0)).astype(np.uint8)))
    assert (darker.kind, darker.views) == ("exposure", (scene.views[6].name,))
    bluer = np.array([0.75, 1.0, 1.2])
    tinted = only(
        with_images(scene, lambda n, image: (image * (bluer if n == 6 else 1.0)).clip(0, 255).astype(np.uint8))
    )
    assert (tinted.kind, tinted.views) == ("white balance", (scene.views[6].name,))


def test_inverted_and_foreign_masks_are_told() -> None:
    masked = little_temple(n_views=8, width=120, height=90, supersampling=1).scene
    assert check_scene(masked) == ()

    def with_masks(mask: Callable[[int], NDArray[np.bool_]]) -> Scene:
        return replace(masked, views=tuple(replace(view, mask=mask(n)) for n, view in enumerate(masked.views)))

    silhouettes = [view.silhouette for view in masked.views]
    assert only(with_masks(lambda n: ~silhouettes[n])).kind == "inverted masks"
    one = only(with_masks(lambda n: ~silhouettes[n] if n == 3 else silhouettes[n]))
    assert (one.kind, one.views) == ("inverted masks", (masked.views[3].name,))
    foreign = np.roll(silhouettes[3], 30, axis=1)
    one = only(with_masks(lambda n: foreign if n == 3 else silhouettes[n]))
    assert (one.kind, one.views) == ("one wrong mask", (masked.views[3].name,))
    mixed = (0, 3, 6, 1, 4, 7, 2, 5)
    assert only(with_masks(lambda n: silhouettes[mixed[n]])).kind == "masks contradict each other"


def test_the_table_and_the_figure_show_every_view(scene: Scene, tmp_path: Path) -> None:
    diagnosis = diagnose(scene, max_views=6)
    heading, *lines = diagnosis.table()
    assert len(lines) == len(scene.views)
    assert "sharp" in heading
    assert "240x180" in lines[0]
    assert sum(line.endswith("-") for line in lines) == len(scene.views) - 6
    assert save_figure(diagnosis, tmp_path / "scene.png").stat().st_size > 10_000


def test_the_temple_gives_no_alarm_and_its_mistakes_are_named(real_data: Path) -> None:
    good = open_scene(real_data / "templeSparseRing", silhouettes="none")
    assert check_scene(good) == ()
    order = np.arange(16)
    order[[2, 7]] = 7, 2
    exchanged = only(ordered(good, order))
    assert exchanged.views == ("templeSR0003.png", "templeSR0008.png")
    assert only(posed(good, np.linalg.inv)).kind == "camera to world"
    assert only(ordered(good, np.random.default_rng(0).permutation(16))).kind == "images in another order"
