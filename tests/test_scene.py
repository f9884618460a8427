from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import plain_view, rotation

from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import SceneError
from recon3d.scene.bounds import Bounds, place_text
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

SKEWED = np.array([[51.0, 3.0, 17.25], [0, 47.0, 14.5], [0, 0, 1]])
BOX = Bounds([-1, -1, -1], [1, 1, 1])


def pose(seed: int = 0) -> NDArray[np.float64]:
    """A camera about five units from the origin that has it in view, turned a little about every axis."""
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = rotation(0.7 * np.random.default_rng(seed).standard_normal(3))
    cam_from_world[:3, 3] = [0.1, -0.2, 5.0]
    return cam_from_world


def grey(height: int = 30, width: int = 40) -> NDArray[np.uint8]:
    return np.full((height, width, 3), 128, np.uint8)


def test_projection_uses_the_whole_intrinsic_matrix_with_skew() -> None:
    view = plain_view(SKEWED, pose())
    points = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    pixels, depth = view.project(points)
    for point, (u, v), z in zip(points, pixels, depth, strict=True):
        x, y, expected_z = pose()[:3, :3] @ point + pose()[:3, 3]
        assert z == pytest.approx(expected_z, abs=1e-12)
        assert u == pytest.approx(51 * x / expected_z + 3 * y / expected_z + 17.25, abs=1e-9)
        assert v == pytest.approx(47 * y / expected_z + 14.5, abs=1e-9)


def test_the_centre_projects_to_depth_zero_and_lies_where_the_pose_says() -> None:
    view = plain_view(SKEWED, pose())
    np.testing.assert_allclose(view.cam_from_world @ [*view.center, 1], [0, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(view.projection @ [*view.center, 1], 0, atol=1e-9)


def test_points_behind_the_camera_have_a_negative_depth() -> None:
    _, depth = plain_view().project(np.array([[0, 0, -6.0], [0, 0, -4.0]]))
    assert depth.tolist() == [-1.0, 1.0]


def test_a_point_at_the_cameras_centre_warns_of_nothing_and_is_not_seen() -> None:
    assert not plain_view().sees(np.array([[0, 0, -5.0]]))[0]


def test_pixel_centres_are_at_integers_and_the_image_ends_half_a_pixel_beyond() -> None:
    view = plain_view(np.array([[10.0, 0, 0], [0, 10.0, 0], [0, 0, 1]]))  # u = 10 x / 5 at z = 0

    def world(u: float, v: float) -> list[float]:
        return [u / 2, v / 2, 0]

    # A thousandth of a pixel to either side of the borders at -0.5, 39.5 and 29.5.
    inside = [world(-0.499, 0), world(39.499, 0), world(0, -0.499), world(0, 29.499)]
    outside = [world(-0.501, 0), world(39.501, 0), world(0, -0.501), world(0, 29.501)]
    assert view.sees(np.array(inside)).all()
    assert not view.sees(np.array(outside)).any()
    assert not view.sees(np.array([[0, 0, -10.0]])).any()


def test_from_matrices_takes_three_or_four_rows() -> None:
    np.testing.assert_array_equal(
        plain_view(SKEWED, pose()[:3]).cam_from_world, plain_view(SKEWED, pose()).cam_from_world
    )


def test_a_view_keeps_its_matrices_exactly() -> None:
    view = plain_view(SKEWED, pose())
    np.testing.assert_array_equal(view.K, SKEWED)
    np.testing.assert_array_equal(view.cam_from_world, pose())
    assert (view.height, view.width) == (30, 40)


def view_with(seed: int = 0, name: str = "a.png") -> View:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    return View.from_matrices(SKEWED, pose(), image, silhouette=rng.random((30, 40)) < 0.5, name=name)


def test_views_are_values() -> None:
    view, copy = view_with(), pickle.loads(pickle.dumps(view_with()))  # noqa: S301
    others = [
        view_with(seed=1), replace(view, name="b"), replace(view, mask=None), replace(view, photograph=grey()),
        replace(view, calibration=replace(view.calibration, cam_from_world=pose(2))),
    ]  # fmt: skip
    assert view == copy
    assert view not in others
    assert len({view, copy, *others}) == 1 + len(others)
    assert view != "a.png"


def test_scenes_are_values_and_their_pickles_hold_no_packing() -> None:
    views = (view_with(), view_with(1, "b.png"))
    scene, packed = Scene(views, BOX, notes={"a": "b"}), Scene(views, BOX, notes={"a": "b"})
    assert packed.packed is packed.packed
    copy = pickle.loads(pickle.dumps(packed))  # noqa: S301
    others = [replace(scene, views=views[:1]), replace(scene, bounds=BOX.padded(1)), replace(scene, notes={})]
    assert scene == packed == copy
    assert scene not in others
    assert len({scene, packed, copy, *others}) == 1 + len(others)
    assert len(pickle.dumps(packed)) == len(pickle.dumps(scene))
    assert copy.fingerprint() == scene.fingerprint()
    np.testing.assert_array_equal(copy.packed.images, packed.packed.images)


def test_scenes_are_packed_once_a_scale_with_the_scaled_cameras() -> None:
    scene = Scene((view_with(), View.from_matrices(SKEWED, pose(), grey(20, 24), name="b")), BOX)
    half = scene.packed_at(0.5)
    assert half is scene.packed_at(0.5)
    assert scene.packed is scene.packed_at(1)
    assert half.cameras.sizes.tolist() == [[20, 15], [12, 10]]
    assert half.images.shape == (2, 15, 20, 3)
    for n, view in enumerate(scene.views):
        camera = view.calibration.at(0.5)
        part = np.s_[n, : camera.height, : camera.width]
        np.testing.assert_array_equal(half.images[part], view.image_at(0.5))
        np.testing.assert_allclose(half.cameras.projections[n], camera.K @ camera.cam_from_world[:3])
        np.testing.assert_allclose(half.cameras.focals[n], scene.packed.cameras.focals[n] / 2)
        silhouette = view.silhouette_at(0.5)
        np.testing.assert_array_equal(half.foreground[part], True if silhouette is None else silhouette)


@pytest.mark.parametrize("with_silhouette", [True, False])
def test_views_pickle(with_silhouette: bool) -> None:
    rng = np.random.default_rng(0)
    silhouette = rng.random((30, 40)) < 0.5 if with_silhouette else None
    image = rng.integers(0, 256, (30, 40, 3), dtype=np.uint8)
    view = View.from_matrices(SKEWED, pose(), image, silhouette=silhouette, name="a.png")
    copy = pickle.loads(pickle.dumps(view))  # noqa: S301
    assert copy.name == "a.png"
    np.testing.assert_array_equal(copy.K, SKEWED)
    np.testing.assert_array_equal(copy.cam_from_world, pose())
    np.testing.assert_array_equal(copy.image, image)
    if silhouette is None:
        assert copy.silhouette is None
    else:
        np.testing.assert_array_equal(copy.silhouette, silhouette)


def changed(matrix: NDArray[np.float64], row: int, column: int, value: float) -> NDArray[np.float64]:
    result = matrix.copy()
    result[row, column] = value
    return result


@pytest.mark.parametrize(
    ("K", "message"),
    [
        (changed(SKEWED, 0, 2, np.nan), "view a: K holds a number that is not finite"),
        (changed(SKEWED, 0, 0, -51), "view a: expected positive focal lengths, got fx=-51, fy=47"),
        (changed(SKEWED, 1, 1, 0), "view a: expected positive focal lengths, got fx=51, fy=0"),
        (changed(SKEWED, 1, 0, 0.1), r"view a: expected K = \[\[fx, skew, cx\]"),
        (changed(SKEWED, 2, 2, 2), r"view a: expected K = \[\[fx, skew, cx\]"),
        (changed(SKEWED, 2, 0, 0.1), r"view a: expected K = \[\[fx, skew, cx\]"),
    ],
)
def test_a_bad_intrinsic_matrix_is_refused(K: NDArray[np.float64], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        View.from_matrices(K, pose(), grey(), name="a")


@pytest.mark.parametrize(
    ("cam_from_world", "message"),
    [
        (changed(pose(), 1, 3, np.inf), "view a: R or t holds a number that is not finite"),
        (np.diag([1.0, 1, -1, 1]), r"view a: R is not a rotation: its determinant is -1 \(a reflection\)"),
        (np.diag([2.0, 2, 2, 1]), "view a: R is not a rotation: R R\\^T differs from the identity by 3"),
        (changed(pose(), 0, 0, 5), "view a: R is not a rotation: R R\\^T differs"),
        (changed(pose(), 3, 0, 0.1), "view a: expected the last row 0 0 0 1"),
    ],
)
def test_a_bad_pose_is_refused(cam_from_world: NDArray[np.float64], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        View.from_matrices(SKEWED, cam_from_world, grey(), name="a")


def test_a_rotation_rounded_to_four_digits_is_accepted() -> None:
    rounded = pose()
    rounded[:3, :3] = rounded[:3, :3].round(4)
    assert not np.allclose(rounded[:3, :3] @ rounded[:3, :3].T, np.eye(3), atol=1e-6)
    assert plain_view(SKEWED, rounded).name == "view"


@pytest.mark.parametrize(
    ("image", "got"),
    [
        (np.zeros((30, 40), np.uint8), r"\(30, 40\) uint8"),
        (np.zeros((30, 40, 4), np.uint8), r"\(30, 40, 4\) uint8"),
        (np.zeros((30, 40, 3)), r"\(30, 40, 3\) float64"),
    ],
)
def test_an_image_that_is_not_rgb_is_refused(image: NDArray[np.uint8], got: str) -> None:
    with pytest.raises(ValueError, match=rf"view a: expected an \(height, width, 3\) uint8 RGB image, got {got}"):
        View.from_matrices(SKEWED, pose(), image, name="a")


def test_a_camera_for_another_image_size_is_refused() -> None:
    with pytest.raises(ValueError, match="view b: the camera is for 40x30 pixels, the image has 41x30"):
        View(plain_view().camera, grey(30, 41), name="b")


@pytest.mark.parametrize(
    ("silhouette", "message"),
    [
        (np.ones((30, 41), np.bool_), "the camera is for 40x30 pixels, the silhouette has 41x30"),
        (np.ones((30, 40), np.uint8), r"expected a bool mask \(height, width\), got \(30, 40\) uint8"),
    ],
)
def test_a_silhouette_that_does_not_fit_the_image_is_refused(silhouette: NDArray[np.bool_], message: str) -> None:
    with pytest.raises(ValueError, match=f"view a: {message}"):
        View.from_matrices(SKEWED, pose(), grey(), silhouette=silhouette, name="a")


def test_bounds_sort_their_corners() -> None:
    bounds = Bounds([1, -2, 3], [-1, 2, 5])
    assert bounds.low == (-1, -2, 3)
    assert bounds.high == (1, 2, 5)
    corners = bounds.corners
    assert {tuple(corner) for corner in corners.tolist()} == {
        (x, y, z) for x in (-1, 1) for y in (-2, 2) for z in (3, 5)
    }
    assert bounds.extent.tolist() == [2, 4, 2]
    assert bounds.center.tolist() == [0, 0, 4]
    assert bounds.longest == 4


def test_bounds_are_values() -> None:
    bounds = Bounds([-1, -2, 3], np.array([1, 2, 5]))
    assert bounds == Bounds((1, 2, 3), (-1, -2, 5))
    assert bounds != Bounds((1, 2, 3), (-1, -2, 6))
    assert len({bounds, pickle.loads(pickle.dumps(bounds)), bounds.padded(0.5)}) == 2  # noqa: S301
    assert bounds.padded(0.5) == Bounds([-1.5, -2.5, 2.5], [1.5, 2.5, 5.5])


def test_bounds_are_made_of_open3ds_box_and_make_one() -> None:
    bounds = Bounds([-1, -2, 3], [1, 2, 5])
    box = bounds.to_open3d()
    assert isinstance(box, o3d.geometry.AxisAlignedBoundingBox)
    assert Bounds.of(box) == Bounds.of(([1, 2, 3], [-1, -2, 5])) == Bounds.of(bounds) == bounds
    view = plain_view()
    assert Scene((view,), box).bounds == bounds  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="expected Bounds, an AxisAlignedBoundingBox or two corners, got 7"):
        Bounds.of(7)


@pytest.mark.parametrize("low", [[0, 0], [0, 0, np.nan], [[0, 0, 0]]])
def test_bounds_need_three_finite_numbers(low: list[float]) -> None:
    with pytest.raises(ValueError, match="expected two corners of three finite numbers"):
        Bounds(low, [1, 1, 1])


def test_a_scene_needs_a_view() -> None:
    with pytest.raises(SceneError, match="scene s: expected at least one view"):
        Scene((), BOX, "s")


def test_view_names_must_differ() -> None:
    views = (plain_view(name="a"), plain_view(name="b"), plain_view(name="a"))
    with pytest.raises(SceneError, match=r"scene s: views share a name: a$"):
        Scene(views, BOX, "s")


@pytest.mark.parametrize("unit", [0.0, -1.0, float("nan")])
def test_the_world_unit_must_be_positive(unit: float) -> None:
    with pytest.raises(ValueError, match="scene s: expected mm_per_unit > 0"):
        Scene((plain_view(),), BOX, "s", unit)


def test_bounds_without_volume_are_refused() -> None:
    with pytest.raises(SceneError, match="scene s: expected bounds with three positive sides"):
        Scene((plain_view(),), Bounds([0, 0, 0], [1, 0, 1]), "s")


def test_bounds_that_no_camera_sees_are_refused() -> None:
    with pytest.raises(SceneError, match="scene s: no camera sees the bounds"):
        Scene((plain_view(),), Bounds([90, 90, 90], [91, 91, 91]), "s")


def test_bounds_larger_than_the_image_are_seen() -> None:
    assert Scene((plain_view(),), Bounds([-9, -9, -2], [9, 9, 2])).corners_in_views().tolist() == [0]


def test_views_may_be_given_as_a_list() -> None:
    scene = Scene([plain_view()], BOX)  # type: ignore[arg-type]
    assert isinstance(scene.views, tuple)


def test_corners_in_views_counts_what_each_image_holds() -> None:
    near = np.eye(4)
    near[2, 3] = 1.5  # the near face projects to 50 / 0.5 = 100 pixels off, the far one to 50 / 2.5 = 20
    views = (
        plain_view(name="far"),
        plain_view(np.array([[30.0, 0, 19.5], [0, 30, 14.5], [0, 0, 1]]), near, name="near"),
    )
    assert Scene(views, BOX).corners_in_views().tolist() == [8, 4]


def test_a_subset_keeps_the_order_of_the_scene_and_everything_else() -> None:
    scene = Scene(tuple(plain_view(name=name) for name in "abc"), BOX, "s", 10.0, {"format": "x"})
    part = scene.subset(["c", "a", "c"])
    assert [view.name for view in part.views] == ["a", "c"]
    assert (part.name, part.mm_per_unit, part.notes) == ("s", 10.0, {"format": "x"})
    assert len(scene.views) == 3


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["v1*"], ["v1.png", "v10.png"]),
        (["v?.png"], ["v1.png", "v2.png"]),
        (["v[2-9].png", "v10.png"], ["v2.png", "v10.png"]),
        (["*"], ["v1.png", "v2.png", "v10.png", "w[1].png"]),
        (["w[1].png"], ["w[1].png"]),
    ],
)
def test_a_subset_takes_wildcards(names: list[str], expected: list[str]) -> None:
    scene = Scene(tuple(plain_view(name=name) for name in ("v1.png", "v2.png", "v10.png", "w[1].png")), BOX)
    assert [view.name for view in scene.subset(names).views] == expected


def test_a_subset_of_unknown_views_is_refused_by_name() -> None:
    scene = Scene((plain_view(name="a"), plain_view(name="b")), BOX)
    with pytest.raises(SceneError, match="scene scene has no view x; it has a, b"):
        scene.subset(["a", "x"])
    with pytest.raises(SceneError, match=r"scene scene has no view z\*; it has a, b"):
        scene.subset(["z*"])


def test_a_subset_of_nothing_is_refused() -> None:
    with pytest.raises(SceneError, match="expected at least one view"):
        Scene((plain_view(),), BOX).subset([])


def test_the_pixel_footprint_is_depth_over_focal_length() -> None:
    # The second camera stands twice as far off: the median of 5 / 50, 5 / 50 and 10 / 50.
    far = np.eye(4)
    far[2, 3] = 10.0
    views = (plain_view(name="a"), plain_view(name="b"), plain_view(None, far, name="c"))
    assert Scene(views, BOX).pixel_footprint == pytest.approx(0.1)
    assert Scene(views[1:], BOX).pixel_footprint == pytest.approx(0.15)


def test_the_summary_speaks_in_millimetres() -> None:
    view = plain_view()
    scene = Scene((view, replace(view, name="b", mask=np.ones((30, 40), np.bool_))), BOX, "s", 10.0, {"a": "<b>"})
    assert scene.summary() == {
        "name": "s",
        "views": 2,
        "image size": "40x30",
        "silhouettes": 1,
        "extent": "20 x 20 x 20 mm",
        "pixel footprint": "1 mm",
        "a": "<b>",
    }
    page = scene._repr_html_()
    assert "&lt;b&gt;" in page
    assert "data:image/png;base64," in page


def test_a_view_shows_itself_in_a_line_and_with_its_photograph() -> None:
    view = plain_view(name="a.png")
    assert repr(view).startswith("View(name: a.png, image size: 40x30, silhouette: not known, focal")
    assert view.summary()["centre"] == "0, 0, -5"
    np.testing.assert_array_equal(view.picture(), view.image)
    assert "data:image/png;base64," in view._repr_html_()


def test_the_camera_is_open3ds_own(temple: BuiltInScene) -> None:
    for view in temple.scene.views:
        assert isinstance(view.camera, o3d.camera.PinholeCameraParameters)
        assert view.camera.intrinsic.width == view.width
    np.testing.assert_array_equal(temple.scene.centers, [view.center for view in temple.scene.views])


def test_places_are_told_to_a_fraction_of_a_length_however_far_from_the_origin() -> None:
    box = Bounds((500000.01, 4000000.02, 100.0), (500000.13, 4000000.1, 100.25))
    assert Bounds(*np.array(box.text.split(","), float).reshape(2, 3)).low == pytest.approx(box.low, abs=2.5e-5, rel=0)
    assert box.text.startswith("500000.01,4000000.02,100,")
    assert place_text((0.1, -2 / 3, 0.0), 0.5) == "0.1,-0.666667,0"
    assert place_text((1 / 3, 2e-7), 0.0) == "0.333333,2e-07"
