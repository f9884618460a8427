"""Scenes of further programs' formats are read to the same cameras; what is wrong in them is named."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foreign import (
    CENTRED,
    FOREIGN,
    SKEWED,
    SQUARE,
    STRAIGHT,
    alicevision,
    bundle,
    openmvg,
    taken_by,
    text,
    write_alicevision,
    write_beside,
    write_blocks,
    write_bouguet,
    write_bundler,
    write_cells,
    write_named_lines,
    write_openmvg,
    write_pmvs,
    write_strecha,
)
from formats import farthest_apart, write_masks, write_photographs
from numpy.typing import NDArray
from scipy.io import savemat

from recon3d.datasets.synthetic import BuiltInScene
from recon3d.errors import DataError
from recon3d.io import FORMATS, open_scene, write_middlebury
from recon3d.io.files import write_image
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

MIRROR = np.diag([1.0, 1.0, -1.0])


@pytest.fixture(scope="module")
def scene(temple: BuiltInScene) -> Scene:
    return temple.scene


def renamed(read: Scene, scene: Scene) -> Scene:
    """What was read, under the names of what was written."""
    views = zip(read.views, scene.views, strict=True)
    return replace(read, views=tuple(replace(view, name=ours.name) for view, ours in views))


def opened(folder: Path, scene: Scene) -> Scene:
    return renamed(open_scene(folder, bounds=scene.bounds, silhouettes="none"), scene)


@pytest.mark.parametrize("form", FOREIGN)
def test_the_same_cameras_and_photographs_are_read(scene: Scene, tmp_path: Path, form: str) -> None:
    write, K = FOREIGN[form]
    scene = taken_by(scene, K)
    write(scene, tmp_path)
    assert [name for name, known in FORMATS.items() if known.recognises(tmp_path)] == [form.partition(",")[0]]
    read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    read = read if "named" in form else renamed(read, scene)
    read = replace(read, views=tuple(sorted(read.views, key=lambda view: view.name)))
    assert farthest_apart(read, scene) < 1e-6
    for view, ours in zip(read.views, scene.views, strict=True):
        np.testing.assert_allclose(view.K, ours.K, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(view.image, ours.image)
    assert read.notes["format"]


@pytest.mark.filterwarnings("ignore:.*silhouettes contradict")  # they are those of the cameras before taken_by
@pytest.mark.parametrize("form", FOREIGN)
def test_masks_and_a_box_are_found(scene: Scene, tmp_path: Path, form: str) -> None:
    write, K = FOREIGN[form]
    write(taken_by(scene, K), tmp_path)
    names = [view.name for view in open_scene(tmp_path, bounds=scene.bounds, silhouettes="none").views]
    by_name = {view.name: view for view in scene.views}
    for name, view in zip(names, scene.views, strict=True):
        write_image(tmp_path / "masks" / f"{name}.png", by_name.get(name, view).silhouette)
    read = open_scene(tmp_path)
    assert read.notes["masks"] == "8 of 8 views, masks"
    assert read.notes["bounds"].endswith(", found from the silhouettes of 8 views")


# The lenses


def seen_through(
    view: View, points: NDArray[np.float64], bent: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """(n, 2) pixels of world points in front of a lens that bends (n, 2) of the plane of depth one."""
    inside = points @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    flat = np.column_stack([bent(inside[:, :2] / inside[:, 2:]), np.ones(len(points))])
    return np.asarray((flat @ view.K.T)[:, :2])


def check_lens(
    read: Scene, scene: Scene, bent: Callable[[NDArray[np.float64]], NDArray[np.float64]], *, farther: float = 0.05
) -> None:
    points = scene.bounds.corners
    for view, ours in zip(read.views, scene.views, strict=True):
        camera = view.calibration
        turn, t = cv2.Rodrigues(camera.cam_from_world[:3, :3])[0], camera.cam_from_world[:3, 3]
        pixels = cv2.projectPoints(points[:, None], turn, t, camera.K, np.array(camera.distortion))[0][:, 0]
        expected = seen_through(ours, points, bent)
        np.testing.assert_allclose(pixels, expected, rtol=0, atol=1e-5)
        assert np.abs(expected - ours.project(points)[0]).max() > farther


def radial(k1: float, k2: float = 0.0, k3: float = 0.0) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    def bent(x: NDArray[np.float64]) -> NDArray[np.float64]:
        r2 = (x**2).sum(axis=1, keepdims=True)
        return np.asarray(x * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3))

    return bent


def brown(k: tuple[float, float, float], t1: float, t2: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    def bent(x: NDArray[np.float64]) -> NDArray[np.float64]:
        r2, xy = (x**2).sum(axis=1), x.prod(axis=1)
        tangential = [t2 * (r2 + 2 * x[:, 0] ** 2) + 2 * t1 * xy, t1 * (r2 + 2 * x[:, 1] ** 2) + 2 * t2 * xy]
        return radial(*k)(x) + np.column_stack(tangential)

    return bent


def test_bundlers_radial_distortion_is_undone(scene: Scene, tmp_path: Path) -> None:
    scene = taken_by(scene, CENTRED)
    write_photographs(scene, tmp_path)
    (tmp_path / "bundle.out").write_text(bundle(scene, (-0.2, 0.3)))
    (tmp_path / "list.txt").write_text("\n".join(view.name for view in scene.views))
    read = opened(tmp_path, scene)
    check_lens(read, scene, radial(-0.2, 0.3))
    assert (read.views[0].image != scene.views[0].image).any()
    assert "images' middle" in read.notes["principal point"]


def test_bouguets_distortion_is_undone(scene: Scene, tmp_path: Path) -> None:
    scene = taken_by(scene, STRAIGHT)
    write_bouguet(scene, tmp_path, kc=(-0.2, 0.3, 0.01, -0.02, 0.1))
    check_lens(opened(tmp_path, scene), scene, brown((-0.2, 0.3, 0.1), 0.01, -0.02))


@pytest.mark.parametrize(
    ("lens", "bent"),
    [
        (lambda base: base | {"disto_k1": [-0.2]}, radial(-0.2)),
        (lambda base: {"value0": base, "disto_k3": [-0.2, 0.3, 0.1]}, radial(-0.2, 0.3, 0.1)),
        (
            lambda base: {"value0": base, "disto_t2": [-0.2, 0.3, 0.1, 0.01, -0.02]},
            brown((-0.2, 0.3, 0.1), 0.01, -0.02),
        ),
    ],
)
def test_openmvgs_distortion_is_undone(
    scene: Scene, tmp_path: Path, lens: Callable[..., Any], bent: Callable[..., Any]
) -> None:
    scene = taken_by(scene, SQUARE)
    write_openmvg(scene, tmp_path)
    (tmp_path / "reconstruction/sfm_data.json").write_text(json.dumps(openmvg(scene, lens)))
    check_lens(opened(tmp_path, scene), scene, bent)


@pytest.mark.parametrize("version", [(1, 0, 0), (1, 2, 0), (1, 2, 1), (1, 2, 2), (1, 2, 4), (1, 2, 5), (1, 2, 11)])
def test_every_version_of_alicevisions_intrinsics_is_read(
    scene: Scene, tmp_path: Path, version: tuple[int, int, int]
) -> None:
    scene = taken_by(scene, SQUARE if version < (1, 2, 0) else STRAIGHT)
    write_alicevision(scene, tmp_path)
    content = alicevision(scene, version, (-0.2, 0.3, 0.1), "radialk3")
    (tmp_path / "cameras.sfm").write_text(json.dumps(content))
    check_lens(opened(tmp_path, scene), scene, radial(-0.2, 0.3, 0.1))


# Signs, and left-handed worlds


@pytest.mark.parametrize(
    ("form", "factors"),
    [("cells", (1.0, 1.0)), ("cells", (-3.0, -3.0)), ("lines", (1.0, -1.0)), ("par", (1.0, 1.0))],
)
def test_a_left_handed_world_is_mirrored_with_its_box(
    scene: Scene, tmp_path: Path, form: str, factors: tuple[float, float]
) -> None:
    """Matrices have one factor and the other in turn."""
    folder = tmp_path / "set"
    writer = {"cells": write_cells, "lines": write_named_lines, "par": write_middlebury}[form]
    writer(scene, folder)
    mirror = np.diag([1, 1, -1, 1])
    flipped = [factors[n % 2] * view.projection @ mirror for n, view in enumerate(scene.views)]
    low, high = scene.bounds.low, scene.bounds.high
    if form == "cells":
        cells = np.empty((1, len(flipped)), object)
        for n, P in enumerate(flipped):
            cells[0, n] = P
        savemat(folder / "dino_Ps.mat", {"P": cells})
    elif form == "lines":
        lines = (f"{v.name} {text(P.reshape(1, 12))}\n" for v, P in zip(scene.views, flipped, strict=True))
        (folder / "cameras.txt").write_text("".join(lines))
    else:
        lines = (
            f"{v.name} {text([*v.K.ravel(), *(v.cam_from_world[:3, :3] @ MIRROR).ravel(), *v.cam_from_world[:3, 3]])}\n"
            for v in scene.views
        )
        next(folder.glob("*_par.txt")).write_text("".join(lines))
    (folder / "README.txt").write_text(f"({low[0]} {low[1]} {-high[2]})\n({high[0]} {high[1]} {-low[2]})\n")
    if form != "par":
        write_masks(scene, folder / "masks")
    if form == "cells":
        for n, view in enumerate(scene.views):
            (folder / "masks" / f"{view.name}.png").rename(folder / "masks" / f"viff.{n:03d}.png")
    with pytest.warns(UserWarning, match="left-handed: it is mirrored"):
        read = open_scene(folder)
    assert farthest_apart(renamed(read, scene), scene) < 1e-6
    np.testing.assert_allclose(read.bounds.center, scene.bounds.center, atol=1e-9)
    assert "mirrored" in read.notes["world"]


def test_one_matrix_of_another_world_is_named(scene: Scene, tmp_path: Path) -> None:
    write_named_lines(scene, tmp_path)
    lines = (tmp_path / "cameras.txt").read_text().splitlines()
    odd = scene.views[4]
    lines[5] = f"{odd.name} {text((odd.projection @ np.diag([1, 1, -1, 1])).reshape(1, 12))}"
    (tmp_path / "cameras.txt").write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"cameras.txt:6: expected matrices of one world: this one's is left-handed"):
        open_scene(tmp_path)


@pytest.mark.parametrize("one", [True, False])
def test_poses_alone_are_refused_with_the_way_out(scene: Scene, tmp_path: Path, *, one: bool) -> None:
    write_photographs(scene, tmp_path / "images")
    lines = [text(view.cam_from_world[:3].reshape(1, 12)) for view in scene.views]
    (tmp_path / "pose").mkdir()
    if one:
        (tmp_path / "poses.txt").write_text("\n".join(lines))
    else:
        for n, line in enumerate(lines):
            (tmp_path / f"pose/{n}.txt").write_text(f"{line} 0 0 0 1")
    with pytest.raises(DataError, match=r"without K; give K and the poses to recon3d.Scene.from_arrays"):
        open_scene(tmp_path)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("fountain.log", "poses alone, no intrinsics: give K beside it"),
        ("groundtruth.txt", "poses alone, no intrinsics: give K beside it"),
        ("sfm.abc", "take cameras.sfm"),
    ],
)
def test_what_lacks_something_is_refused_with_the_way_out(scene: Scene, tmp_path: Path, name: str, told: str) -> None:
    write_photographs(scene, tmp_path)
    rows = (f"{n} {n} 0\n{text(np.linalg.inv(view.cam_from_world))}\n" for n, view in enumerate(scene.views))
    (tmp_path / name).write_text("".join(rows))
    with pytest.raises(DataError, match="not a known scene") as error:
        open_scene(tmp_path)
    assert told in str(error.value)


# Views that are left out


def test_cameras_that_are_not_registered_are_left_out(scene: Scene, tmp_path: Path) -> None:
    scene = taken_by(scene, CENTRED)
    write_bundler(scene, tmp_path / "bundler")
    lines = (tmp_path / "bundler/bundle/bundle.out").read_text().splitlines()
    lines[7:12] = ["0 0 0"] * 5
    (tmp_path / "bundler/bundle/bundle.out").write_text("\n".join(lines))
    write_bouguet(scene, tmp_path / "bouguet")
    script = (tmp_path / "bouguet/Calib_Results.m").read_text()
    start = script.index("omc_2 =")
    script = (
        script[:start]
        + "omc_2 = [ NaN ; NaN ; NaN ];\nTc_2 = [ NaN ; NaN ; NaN ];"
        + script[script.index("%-- Image #3") :]
    )
    (tmp_path / "bouguet/Calib_Results.m").write_text(script)
    write_openmvg(scene, tmp_path / "openmvg")
    content = openmvg(scene)
    del content["extrinsics"][1]
    (tmp_path / "openmvg/reconstruction/sfm_data.json").write_text(json.dumps(content))
    write_alicevision(scene, tmp_path / "alicevision")
    content = alicevision(scene)
    del content["poses"][1]
    (tmp_path / "alicevision/cameras.sfm").write_text(json.dumps(content))
    kept = replace(scene, views=(scene.views[0], *scene.views[2:]))
    for form in ("bundler", "bouguet", "openmvg", "alicevision"):
        read = open_scene(tmp_path / form, bounds=scene.bounds, silhouettes="none")
        assert farthest_apart(renamed(read, kept), kept) < 1e-6, form
        assert read.notes["left out"]


# Files that are wrong


def change(file: Path, old: str, new: str) -> None:
    content = file.read_text()
    assert old in content
    file.write_text(content.replace(old, new, 1))


WRONG: dict[str, tuple[Callable[[Scene, Path], None], str, str, str, str]] = {
    "Strecha, nan": (
        write_strecha,
        "gt_dense_cameras/view03.png.camera",
        "376.0",
        "nan",
        "view03.png.camera: expected 26",
    ),
    "Strecha, size": (write_strecha, "gt_dense_cameras/view03.png.camera", "160.0", "-160", "view03.png.camera: width"),
    "Strecha, lens": (write_strecha, "gt_dense_cameras/view03.png.camera", "0.0 0.0 0.0\n", "0.1 0 0\n", "undistort"),
    "Bouguet, nan": (write_bouguet, "Calib_Results.m", "fc = [ 376.0", "fc = [ nan", "Calib_Results.m: fc: expected 2"),
    "Bouguet, code": (write_bouguet, "Calib_Results.m", "Tc_3  = [", "Tc_3 = [ system('x')", "Calib_Results.m: Tc_3"),
    "Bouguet, huge": (write_bouguet, "Calib_Results.m", "nx = 160", "nx = 1e300", "Calib_Results.m: nx"),
    "Bouguet, lost": (write_bouguet, "Calib_Results.m", "Tc_3 ", "Td_3 ", "expected Tc_3 = "),
    "PMVS, short": (write_pmvs, "txt/00000003.txt", "CONTOUR\n", "CONTOUR\n1 2 3 4\n", "00000003.txt:5: .* got 1"),
    "PMVS, inf": (write_pmvs, "txt/00000000.txt", "CONTOUR\n", "CONTOUR\n1 2 3 inf\n", "00000000.txt:2: .* finite"),
    "PMVS, empty": (write_pmvs, "txt/00000003.txt", "CONTOUR\n", "CONTOUR\n#", "00000003.txt.* got 2"),
    "lines, nan": (write_named_lines, "cameras.txt", "view05.png ", "view05.png nan ", "cameras.txt:6: expected 4, 12"),
    "lines, twice": (write_named_lines, "cameras.txt", "view05.png", "view06.png", "names that differ, got view06.png"),
    "lines, singular": (
        write_named_lines,
        "cameras.txt",
        "view05.png",
        "view05.png 0 0 0 0 0 0 0 0 0 0 0 0\n#",
        "cameras.txt:6: expected a projection matrix of a camera at a finite place",
    ),
    "OpenMVG, nan": (write_openmvg, "reconstruction/sfm_data.json", "376.0", "NaN", "view 0 .*focal_length"),
    "OpenMVG, fisheye": (
        write_openmvg,
        "reconstruction/sfm_data.json",
        '"focal_length"',
        '"fisheye": [1, 2, 3, 4], "focal_length"',
        "a lens with fisheye cannot be undone",
    ),
    "OpenMVG, before": (write_openmvg, "reconstruction/sfm_data.json", '"extrinsics"', '"x"', "before the reconstruct"),
    "AliceVision, huge": (
        write_alicevision,
        "cameras.sfm",
        '"0", "width": "160"',
        '"0", "width": "1e30"',
        "view .*png: width",
    ),
    "AliceVision, lens": (write_alicevision, "cameras.sfm", '"pinhole"', '"fisheye"', "the lens fisheye none cannot"),
    "AliceVision, before": (write_alicevision, "cameras.sfm", '"poses"', '"x"', "before the reconstruction"),
    "AliceVision, sensor": (write_alicevision, "cameras.sfm", '"36"', '"0"', "expected sensorWidth"),
    "Bundler, negative": (
        write_bundler,
        "bundle/bundle.out",
        "\n8 0\n",
        "\n-8 0\n",
        "bundle.out:2: the file cannot hold -8",
    ),
    "Bundler, huge": (write_bundler, "bundle/bundle.out", "\n8 0\n", "\n8 4000000000\n", "bundle.out:2: .* points"),
    "Bundler, fraction": (write_bundler, "bundle/bundle.out", "\n8 0\n", "\n8.5 0\n", "bundle.out:2: .* 8.5 cameras"),
    "Bundler, nan": (write_bundler, "bundle/bundle.out", "376.0 0", "376.0 nan", "bundle.out:3: f, k1, k2 of camera 0"),
    "Bundler, cut": (write_bundler, "bundle/bundle.out", "\n8 0\n", "\n8 1\n", "ends behind line 42, expected point 0"),
    "Bundler, old": (write_bundler, "bundle/bundle.out", "v0.3", "v0.1", "expected version 0.3"),
    "Bundler, list": (write_bundler, "list.txt", "./view03.png 0 534.5\n", "", "for each of 8 cameras .* got 7"),
}


@pytest.mark.parametrize("form", WRONG)
def test_what_is_wrong_is_named_with_its_place(scene: Scene, tmp_path: Path, form: str) -> None:
    write, file, old, new, told = WRONG[form]
    write(taken_by(scene, CENTRED), tmp_path)
    change(tmp_path / file, old, new)
    with pytest.raises(DataError, match=told):
        open_scene(tmp_path)


def test_a_mat_file_that_unpacks_to_gigabytes_is_refused(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path)
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    packed = zlib.compress(bytes(40 * 2**20))
    (tmp_path / "P.mat").write_bytes(header + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(DataError, match="not a known scene"):
        open_scene(tmp_path)


@pytest.mark.parametrize("where", [130, 158, 162])
def test_a_mat_file_that_is_damaged_is_refused(scene: Scene, tmp_path: Path, where: int) -> None:
    write_photographs(scene, tmp_path)
    stack = np.array([view.projection for view in scene.views])
    savemat(tmp_path / "Ps.mat", {"Ps": stack})
    data = bytearray((tmp_path / "Ps.mat").read_bytes())
    data[where : where + 2] = b"\xff\xff"
    (tmp_path / "Ps.mat").write_bytes(data)
    with pytest.raises(DataError, match="not a known scene"):
        open_scene(tmp_path)


def test_names_that_no_file_can_have_are_missing(scene: Scene, tmp_path: Path) -> None:
    write_bundler(taken_by(scene, CENTRED), tmp_path)
    change(tmp_path / "list.txt", "./view03.png", "x" * 5000)
    change(tmp_path / "list.txt", "./view04.png", "view\0.png")
    with pytest.warns(UserWarning, match="left out, their photographs are missing: x+, view"):
        read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
    assert len(read.views) == 6


def test_a_mat_file_may_hold_an_array_of_any_order(scene: Scene, tmp_path: Path) -> None:
    scene = taken_by(scene, SKEWED)
    write_photographs(scene, tmp_path)
    stack = np.array([view.projection for view in scene.views])
    for array in (stack, np.moveaxis(stack, 0, 2), stack.reshape(-1, 12), stack.reshape(-1, 4)):
        savemat(tmp_path / "Ps.mat", {"Ps": array, "note": "of a robot arm"})
        assert farthest_apart(opened(tmp_path, scene), scene) < 1e-6


def test_points_of_bundler_bound_the_object(scene: Scene, tmp_path: Path) -> None:
    scene = taken_by(scene, CENTRED)
    write_bundler(scene, tmp_path)
    points = np.random.default_rng(1).uniform(scene.bounds.low, scene.bounds.high, (200, 3))
    (tmp_path / "bundle/bundle.out").write_text(bundle(scene, points=points))
    read = open_scene(tmp_path, silhouettes="none")
    assert read.notes["bounds"].endswith("found from 200 of 200 points")
    assert np.abs(np.subtract(read.bounds.low, scene.bounds.low)).max() < 0.1 * scene.bounds.longest


def test_files_of_matrices_may_be_called_after_the_photographs_number(scene: Scene, tmp_path: Path) -> None:
    write_beside(scene, tmp_path)
    for n, view in enumerate(scene.views, start=1):
        (tmp_path / f"{view.name}.P").rename(tmp_path / f"pose_{n}_P.txt")
    assert farthest_apart(opened(tmp_path, scene), scene) < 1e-6


@pytest.mark.parametrize("form", FOREIGN)
def test_photographs_may_lie_elsewhere(scene: Scene, tmp_path: Path, form: str) -> None:
    write, K = FOREIGN[form]
    scene = taken_by(scene, K)
    write(scene, tmp_path / "set")
    (tmp_path / "photographs").mkdir()
    for image in (*(tmp_path / "set").rglob("*.png"), *(tmp_path / "set").rglob("*.ppm")):
        image.rename(tmp_path / "photographs" / image.name)
    with pytest.raises(DataError):
        open_scene(tmp_path / "set")
    read = open_scene(tmp_path / "set", bounds=scene.bounds, silhouettes="none", images=tmp_path / "photographs")
    assert len(read.views) == 8
    assert read.name == "set"


def test_matrices_are_read_as_people_write_them(scene: Scene, tmp_path: Path) -> None:
    write_named_lines(scene, tmp_path)
    scene = taken_by(scene, scene.views[0].K)
    file = tmp_path / "cameras.txt"
    plain = file.read_text().replace(".png ", ".png: ")
    ways = (
        plain.encode("utf-16"),
        plain.replace("\n", "\r\n").encode("utf-8-sig"),
        "\n".join(
            line if "png" not in line else line.split(": ")[0] + ": " + line.split(": ")[1].replace(".", ",")
            for line in plain.splitlines()
        ).encode(),
        plain.replace(" ", ", ").replace("#, name, P", "# name P").encode(),
        "\n".join(
            line.replace(": ", ": [").replace("png: [", "png [") + "]" for line in plain.splitlines()[2:]
        ).encode(),
    )
    for content in ways:
        file.write_bytes(content)
        read = open_scene(tmp_path, bounds=scene.bounds, silhouettes="none")
        read = replace(read, views=read.views[::-1])
        assert farthest_apart(read, scene) < 1e-6, content[:80]


def test_an_empty_file_of_a_matrix_is_named(scene: Scene, tmp_path: Path) -> None:
    write_pmvs(scene, tmp_path)
    (tmp_path / "txt/00000003.txt").write_text("")
    with pytest.raises(DataError, match=r"00000003.txt: expected a projection matrix of 3x4 numbers, got none"):
        open_scene(tmp_path)


def test_a_list_of_points_is_no_list_of_matrices(scene: Scene, tmp_path: Path) -> None:
    write_photographs(scene, tmp_path)
    (tmp_path / "points.txt").write_text(text(np.random.default_rng(0).uniform(0, 1, (24, 4))))
    with pytest.raises(DataError, match="not a known scene"):
        open_scene(tmp_path)
    write_blocks(scene, tmp_path)
    assert open_scene(tmp_path, bounds=Bounds(scene.bounds.low, scene.bounds.high)).notes["format"].startswith("projec")
