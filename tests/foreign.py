"""The built-in temple as further programs would write it: what each format's own documentation says, by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from formats import write_photographs
from numpy.typing import ArrayLike, NDArray
from scipy.io import savemat

from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene

SKEWED = ((376.0, 0.4, 82.8), (0.0, 377.5, 57.4), (0.0, 0.0, 1.0))
STRAIGHT = ((376.0, 0.0, 82.8), (0.0, 377.5, 57.4), (0.0, 0.0, 1.0))
SQUARE = ((376.0, 0.0, 82.8), (0.0, 376.0, 57.4), (0.0, 0.0, 1.0))
CENTRED = ((376.0, 0.0, 79.5), (0.0, 376.0, 59.5), (0.0, 0.0, 1.0))


def taken_by(scene: Scene, K: ArrayLike) -> Scene:
    """The scene with a K, that of all views; the photographs are as they were."""
    return replace(
        scene,
        views=tuple(
            replace(view, calibration=Camera(K, view.cam_from_world, view.width, view.height)) for view in scene.views
        ),
    )


def text(values: ArrayLike, end: str = "\n") -> str:
    """Rows of numbers, to the last digit."""
    return end.join(" ".join(map(repr, row)) for row in np.atleast_2d(values).astype(float).tolist())


def write_strecha(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    (folder / "gt_dense_cameras").mkdir()
    for view in scene.views:
        rows = (view.K, np.zeros(3), view.cam_from_world[:3, :3].T, view.center, [view.width, view.height])
        (folder / f"gt_dense_cameras/{view.name}.camera").write_text("\n".join(map(text, rows)) + "\n")


def write_bouguet(scene: Scene, folder: Path, *, kc: Sequence[float] = (0, 0, 0, 0, 0)) -> None:
    write_photographs(scene, folder, [f"Image{n}.png" for n in range(1, len(scene.views) + 1)])
    K = scene.views[0].K
    column = " ; ".join
    lines = [
        "% Intrinsic and Extrinsic Camera Parameters",
        f"fc = [ {column(map(repr, (float(K[0, 0]), float(K[1, 1]))))} ];",
        f"cc = [ {column(map(repr, K[:2, 2].tolist()))} ];",
        f"alpha_c = {float(K[0, 1] / K[0, 0])!r};",
        f"kc = [ {column(map(repr, map(float, kc)))} ];",
        "fc_error = [ 1.2 ; 1.3 ];",
        f"nx = {scene.views[0].width};\nny = {scene.views[0].height};",
        f"n_ima = {len(scene.views)};",
    ]
    for n, view in enumerate(scene.views, start=1):
        turn = cv2.Rodrigues(view.cam_from_world[:3, :3])[0].ravel().tolist()
        lines += [
            f"%-- Image #{n}:",
            f"omc_{n} = [ {column(map(repr, turn))} ];",
            f"Tc_{n}  = [ {column(map(repr, view.cam_from_world[:3, 3].tolist()))} ];",
            f"omc_error_{n} = [ 1.0e-03 ; 2.0e-03 ; 3.0e-03 ];",
        ]
    (folder / "Calib_Results.m").write_text("\n".join(lines) + "\n")


def write_pmvs(scene: Scene, folder: Path) -> None:
    names = [f"{n:08d}" for n in range(len(scene.views))]
    write_photographs(scene, folder / "visualize", [f"{name}.png" for name in names])
    (folder / "txt").mkdir()
    for name, view in zip(names, scene.views, strict=True):
        (folder / f"txt/{name}.txt").write_text(f"CONTOUR\n{text(view.projection)}\n")


def write_named_lines(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    lines = (f"{view.name} {text(view.projection.reshape(1, 12))}\n" for view in scene.views[::-1])
    (folder / "cameras.txt").write_text("# name P\n8\n" + "".join(lines))


def write_blocks(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder)
    blocks = (text(-2.5 * view.projection) + "\n0 0 0 1\n\n" for view in scene.views)
    (folder / "P.txt").write_text("".join(blocks))


def write_beside(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder)
    for view in scene.views:
        (folder / f"{view.name}.P").write_text(text(view.projection, "; "))


def write_npy(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    np.save(folder / "projections.npy", np.array([view.projection for view in scene.views]))


def write_cells(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder, [f"viff.{n:03d}.ppm" for n in range(len(scene.views))])
    cells = np.empty((1, len(scene.views)), object)
    for n, view in enumerate(scene.views):
        cells[0, n] = view.projection
    savemat(folder / "dino_Ps.mat", {"P": cells}, do_compression=True)


def write_mat_variables(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder)
    savemat(folder / "cameras.mat", {f"P{n}": view.projection for n, view in enumerate(scene.views, start=1)})


def openmvg(scene: Scene, lens: Callable[[dict[str, Any]], dict[str, Any]] = lambda base: base) -> dict[str, Any]:
    """Content of a ``sfm_data.json``; a lens is made of its base's fields."""
    views, lenses, poses = [], [], []
    for n, view in enumerate(scene.views):
        pointer = {"local_path": "", "filename": view.name, "width": view.width, "height": view.height}
        pointer |= {"id_view": n, "id_intrinsic": n, "id_pose": n + 100}
        views.append({"key": n, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": n, "data": pointer}}})
        base = {"width": view.width, "height": view.height, "focal_length": view.K[0, 0]}
        base |= {"principal_point": view.K[:2, 2].tolist()}
        first = {"polymorphic_name": "pinhole"} if n == 0 else {}
        wrapped = {"polymorphic_id": 1, **first, "ptr_wrapper": {"id": n, "data": lens(base)}}
        lenses.append({"key": n, "value": wrapped})
        pose = {"rotation": view.cam_from_world[:3, :3].tolist(), "center": view.center.tolist()}
        poses.append({"key": n + 100, "value": pose})
    return {
        "sfm_data_version": "0.3",
        "root_path": "/somewhere/else",
        "views": views,
        "intrinsics": lenses,
        "extrinsics": poses,
        "structure": [],
        "control_points": [],
    }


def write_openmvg(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    (folder / "reconstruction").mkdir()
    (folder / "reconstruction/sfm_data.json").write_text(json.dumps(openmvg(scene)))


def alicevision(
    scene: Scene, version: tuple[int, int, int] = (1, 2, 8), distortion: Sequence[float] = (), kind: str = "none"
) -> dict[str, Any]:
    """Content of a ``cameras.sfm``, all numbers as text."""
    views, lenses, poses = [], [], []
    for n, view in enumerate(scene.views):
        ids = {"viewId": str(n), "poseId": str(n), "intrinsicId": str(n)}
        views.append({**ids, "path": f"/home/me/{view.name}", "width": str(view.width), "height": str(view.height)})
        K = view.K
        lens: dict[str, Any] = {"intrinsicId": str(n), "width": str(view.width), "height": str(view.height)}
        lens |= {"type": "pinhole", "distortionType": kind, "distortionParams": [repr(float(k)) for k in distortion]}
        lens["distortionParams"] = lens["distortionParams"] or ""
        middle = np.array([view.width, view.height]) / 2 if version >= (1, 2, 1) else 0
        lens["principalPoint"] = [repr(float(x)) for x in K[:2, 2] - middle]
        if version < (1, 2, 2):
            both = [repr(float(K[0, 0])), repr(float(K[1, 1]))]
            lens["pxFocalLength"] = both if version >= (1, 2, 0) else both[0]
        else:
            ratio = K[0, 0] / K[1, 1] if version < (1, 2, 5) else K[1, 1] / K[0, 0]
            lens |= {"sensorWidth": "36", "focalLength": repr(float(K[0, 0] * 36 / view.width))}
            lens |= {"pixelRatio": repr(float(ratio))}
        lenses.append(lens)
        R = view.cam_from_world[:3, :3]
        transform = {"rotation": [repr(x) for x in R.T.ravel().tolist()], "center": list(map(str, view.center))}
        poses.append({"poseId": str(n), "pose": {"transform": transform, "locked": "0"}})
    return {"version": list(map(str, version)), "views": views, "intrinsics": lenses, "poses": poses}


def write_alicevision(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder / "images")
    (folder / "cameras.sfm").write_text(json.dumps(alicevision(scene)))


def bundle(scene: Scene, k: tuple[float, float] = (0, 0), points: NDArray[np.float64] | None = None) -> str:
    """Content of a ``bundle.out``."""
    points = np.zeros((0, 3)) if points is None else points
    lines = ["# Bundle file v0.3", f"{len(scene.views)} {len(points)}"]
    for view in scene.views:
        pose = np.diag([1.0, -1.0, -1.0]) @ view.cam_from_world[:3]
        lines += [text([view.K[0, 0], *k]), text(pose[:, :3]), text(pose[:, 3])]
    for point in points:
        lines += [text(point), "9 9 9", "2 0 5 1.5 2.5 1 7 -1.5 3.5"]
    return "\n".join(lines) + "\n"


def write_bundler(scene: Scene, folder: Path) -> None:
    write_photographs(scene, folder)
    (folder / "bundle").mkdir()
    (folder / "bundle/bundle.out").write_text(bundle(scene))
    (folder / "list.txt").write_text("".join(f"./{view.name} 0 534.5\n" for view in scene.views))


FOREIGN: dict[str, tuple[Callable[[Scene, Path], None], ArrayLike]] = {
    "strecha": (write_strecha, SKEWED),
    "bouguet": (write_bouguet, SKEWED),
    "matrices, PMVS": (write_pmvs, SKEWED),
    "matrices, named": (write_named_lines, SKEWED),
    "matrices, 4x4 of another scale": (write_blocks, SKEWED),
    "matrices, beside the photographs": (write_beside, SKEWED),
    "matrices, NumPy": (write_npy, SKEWED),
    "matrices, cells": (write_cells, SKEWED),
    "matrices, variables": (write_mat_variables, SKEWED),
    "openmvg": (write_openmvg, SQUARE),
    "alicevision": (write_alicevision, STRAIGHT),
    "bundler": (write_bundler, CENTRED),
}
"""Writers of formats, and a K that each can hold."""
