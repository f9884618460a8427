from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh, cameras, photographs, stripes

from recon3d.cli.scenes import warn_of_findings
from recon3d.diagnosis import check_scene
from recon3d.errors import SceneWarning
from recon3d.scene.mask_holes import contradicted_holes
from recon3d.scene.scene import Scene
from recon3d.scene.segmentation import with_segmented_silhouettes
from recon3d.scene.silhouettes import without_silhouettes

BLACK = (0, 0, 0)
SPOT = np.array([0.45, -0.5, 0.55]) / np.linalg.norm([0.45, -0.5, 0.55])


def spotted(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """A ball's stripes with a dark spot, like an eye."""
    dark = points @ SPOT > 0.96
    return np.where(dark[:, None], 0.12, stripes(points))


@pytest.fixture(scope="module")
def ball() -> Scene:
    return photographs(ball_mesh(), spotted, cameras(8, arc=360, width=160, height=120), supersampling=2)


def test_exact_masks_have_no_hole(ball: Scene) -> None:
    assert contradicted_holes(ball.views, ball.bounds, BLACK) == {}


@pytest.mark.parametrize("place", [(60, 80), (48, 68)])
def test_a_hole_in_one_mask_is_found_and_no_more(ball: Scene, place: tuple[int, int]) -> None:
    rows, columns = np.mgrid[:120, :160]
    hole = (rows - place[0]) ** 2 + (columns - place[1]) ** 2 < 8**2
    mask = np.asarray(ball.views[3].silhouette) & ~hole
    views = tuple(replace(view, mask=mask) if n == 3 else view for n, view in enumerate(ball.views))
    found = contradicted_holes(views, ball.bounds, BLACK)
    assert list(found) == [3]
    np.testing.assert_array_equal(found[3], hole)


def test_three_masks_contradict_nothing(ball: Scene) -> None:
    hole = np.zeros((120, 160), np.bool_)
    hole[55:65, 75:85] = True
    views = tuple(replace(view, mask=np.asarray(view.silhouette) & ~hole) for view in ball.views[:3])
    assert contradicted_holes(views, ball.bounds, BLACK) == {}


def gate() -> Scene:
    """Two thick walls with a narrow gap that the first of the views alone looks through."""
    walls = box_mesh(2.0, 0.5, 1.2).translate((0, 0.42, 0)) + box_mesh(2.0, 0.5, 1.2).translate((0, -0.42, 0))
    return photographs(walls, stripes, cameras(8, arc=360, width=160, height=120), supersampling=2)


def test_a_gap_that_one_view_alone_looks_through_stays() -> None:
    scene = gate()
    mask = np.asarray(scene.views[0].silhouette)
    row = mask[np.flatnonzero(mask.any(axis=1))[len(np.flatnonzero(mask.any(axis=1))) // 2]]
    inside = row[np.flatnonzero(row)[0] : np.flatnonzero(row)[-1]]
    assert (~inside).sum() > 4
    assert contradicted_holes(scene.views, scene.bounds, BLACK) == {}


def test_a_hole_in_a_given_mask_is_told_and_not_changed(ball: Scene) -> None:
    assert check_scene(ball) == ()
    rows, columns = np.mgrid[:120, :160]
    mask = np.asarray(ball.views[3].silhouette) & ((rows - 48) ** 2 + (columns - 68) ** 2 >= 8**2)
    views = [replace(view, mask=mask) if n == 3 else view for n, view in enumerate(ball.views)]
    (finding,) = check_scene(replace(ball, views=tuple(views)))
    assert (finding.kind, finding.about, finding.views) == ("holes in masks", "masks", (ball.views[3].name,))
    assert f"contradict: {ball.views[3].name} near pixel 68,48. Nothing is changed" in finding.message
    np.testing.assert_array_equal(views[3].silhouette, mask)


@pytest.fixture
def spoiled(monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], dict[str, NDArray[np.bool_]]]:
    """One view's segmentation takes the dark spot for background: how many pixels, and the right silhouettes."""
    from recon3d.scene import segmentation

    cut, spoiled, right = segmentation._grab_cut, [], {}

    def without_the_spot(view: segmentation.View, *options: object) -> NDArray[np.bool_]:
        right[view.name] = mask = cut(view, *options)  # type: ignore[arg-type]
        if view.name != "view08.png":
            return mask
        rows, columns = np.mgrid[: view.height, : view.width]
        spot = mask & (view.image.max(axis=2) < 60) & ((rows - 60) ** 2 + (columns - 80) ** 2 < 30**2)
        spoiled.append(int(spot.sum()))
        return np.asarray(mask & ~spot)

    monkeypatch.setattr(segmentation, "_grab_cut", without_the_spot)
    return spoiled, right


Spoiled = tuple[list[int], dict[str, NDArray[np.bool_]]]


def test_segmented_silhouettes_are_mended_with_a_word(ball: Scene, spoiled: Spoiled) -> None:
    with pytest.warns(SceneWarning, match=r"were filled: view08\.png \(\d+ pixels\)$"):
        mended = {view.name: view.silhouette for view in with_segmented_silhouettes(without_silhouettes(ball)).views}
    (n_spoiled,), right = spoiled
    assert n_spoiled > 80
    for name, mask in mended.items():
        assert (mask != right[name]).sum() <= 0.05 * n_spoiled


@pytest.mark.usefixtures("spoiled")
def test_a_check_tells_of_mended_silhouettes_once(ball: Scene) -> None:
    segmented = with_segmented_silhouettes(without_silhouettes(ball))
    with pytest.warns(UserWarning, match="they are filled: view08") as warned:
        warn_of_findings(segmented, [])
    assert len(warned) == 1


@pytest.mark.usefixtures("spoiled")
def test_a_check_alone_warns_of_nothing(ball: Scene) -> None:
    (finding,) = check_scene(with_segmented_silhouettes(without_silhouettes(ball)))
    assert (finding.kind, finding.views) == ("filled holes", ("view08.png",))
