"""The built-in temple as other programs would write it."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.io.files import write_image
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene
from recon3d.scene.view import View


def without_skew(scene: Scene) -> Scene:
    """The scene as cameras without skew would have taken it; the photographs are as they were."""

    def straight(view: View) -> View:
        K = view.K
        K[0, 1] = 0.0
        return replace(view, calibration=Camera(K, view.cam_from_world, view.width, view.height))

    return replace(scene, views=tuple(map(straight, scene.views)))


def write_photographs(scene: Scene, folder: Path, names: Sequence[str] | None = None) -> None:
    """The views' photographs under their own names, or under others."""
    for view, name in zip(scene.views, names or [view.name for view in scene.views], strict=True):
        write_image(folder / name, view.image)


def write_masks(scene: Scene, folder: Path, form: str = "{name}.png") -> None:
    """The views' silhouettes, named like the views."""
    for view in scene.views:
        assert view.silhouette is not None
        write_image(folder / form.format(name=view.name, stem=Path(view.name).stem), view.silhouette)


def farthest_apart(read: Scene, expected: Scene) -> float:
    """Largest distance in pixels between where the views of two scenes see the corners of the bounds; same names."""
    assert [Path(view.name).stem for view in read.views] == [Path(view.name).stem for view in expected.views]
    return max(
        float(np.abs(a.project(expected.bounds.corners)[0] - b.project(expected.bounds.corners)[0]).max())
        for a, b in zip(read.views, expected.views, strict=True)
    )


def quaternion(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) w, x, y, z of a rotation."""
    vector = cv2.Rodrigues(R)[0].ravel()
    angle = float(np.linalg.norm(vector))
    axis = vector / max(angle, 1e-300)
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


def write_colmap(
    scene: Scene,
    model: Path,
    *,
    binary: bool = False,
    lens: str = "PINHOLE",
    coefficients: Sequence[float] = (),
    points: NDArray[np.float64] | None = None,
) -> None:
    """A model with one camera a view; the upper left pixel's centre is (0.5, 0.5)."""
    model.mkdir(parents=True, exist_ok=True)
    ids = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5}
    ids["FULL_OPENCV"] = 6
    cameras, images = [], []
    for n, view in enumerate(scene.views, start=1):
        focal = (
            (view.K[0, 0],) if lens in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else (view.K[0, 0], view.K[1, 1])
        )
        parameters = (*focal, view.K[0, 2] + 0.5, view.K[1, 2] + 0.5, *coefficients)
        cameras.append((n, lens, view.width, view.height, parameters))
        images.append((n, *quaternion(view.cam_from_world[:3, :3]), *view.cam_from_world[:3, 3], n, view.name))
    corners = scene.bounds.corners if points is None else points
    if not binary:
        (model / "cameras.txt").write_text(
            "# CAMERA_ID, MODEL\n"
            + "".join(f"{n} {m} {w} {h} {' '.join(map(repr, map(float, p)))}\n" for n, m, w, h, p in cameras)
        )
        (model / "images.txt").write_text(
            "# two lines an image\n"
            + "".join(
                " ".join(map(str, image)) + ("\n1.5 2.5 -1 7 8 1\n" if image[0] % 2 else "\n\n") for image in images
            )
        )
        (model / "points3D.txt").write_text(
            "".join(
                f"{n} {x!r} {y!r} {z!r} 9 9 9 0.1 1 0 2 0\n" for n, (x, y, z) in enumerate(corners.tolist(), start=1)
            )
        )
        return
    data = struct.pack("<Q", len(cameras))
    for n, name, width, height, parameters in cameras:
        data += struct.pack(f"<IiQQ{len(parameters)}d", n, ids[name], width, height, *parameters)
    (model / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for n, *pose, camera, name in images:
        data += struct.pack("<I7dI", n, *pose, camera) + name.encode() + b"\0"
        data += struct.pack("<Qddqddq", 2, 1.5, 2.5, -1, 7.0, 8.0, 1)
    (model / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(corners))
    for n, point in enumerate(corners.tolist(), start=1):
        data += struct.pack("<Q3d3BdQ4I", n, *point, 9, 9, 9, 0.1, 2, 1, 0, 2, 0)
    (model / "points3D.bin").write_bytes(data)


def opengl_from(view: View) -> NDArray[np.float64]:
    """(4, 4) camera to world with OpenGL's axes."""
    return np.asarray(np.linalg.inv(view.cam_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0]))


def transforms(scene: Scene, form: str = "images/{name}") -> dict[str, Any]:
    """Content of a ``transforms.json`` with each view's own intrinsics; pixels are counted from the corner."""
    return {
        "camera_model": "OPENCV",
        "frames": [
            {
                "file_path": form.format(name=view.name, stem=Path(view.name).stem),
                "transform_matrix": opengl_from(view).tolist(),
                "fl_x": view.K[0, 0],
                "fl_y": view.K[1, 1],
                "cx": view.K[0, 2] + 0.5,
                "cy": view.K[1, 2] + 0.5,
                "w": view.width,
                "h": view.height,
            }
            for view in scene.views
        ],
    }


def metashape(scene: Scene, *, chunk: tuple[float, NDArray[np.float64], NDArray[np.float64]], skip: str = "") -> str:
    """Cameras as Metashape exports them, in a chunk of a scale, rotation and translation; one may be left unaligned."""
    scale, R, t = chunk
    sensors, cameras = "", ""
    for n, view in enumerate(scene.views):
        K = view.K
        sensors += (
            f'<sensor id="{n}" type="frame"><resolution width="{view.width}" height="{view.height}"/>'
            '<calibration type="frame" class="initial"><f>99</f></calibration>'
            '<calibration type="frame" class="adjusted">'
            f'<resolution width="{view.width}" height="{view.height}"/><f>{float(K[1, 1])!r}</f>'
            f"<cx>{float(K[0, 2] + 0.5 - view.width / 2)!r}</cx><cy>{float(K[1, 2] + 0.5 - view.height / 2)!r}</cy>"
            f"<b1>{float(K[0, 0] - K[1, 1])!r}</b1><b2>{float(K[0, 1])!r}</b2>"
            "<k1>-0.1</k1><k2>0.02</k2><k3>0.003</k3><p1>0.0004</p1><p2>-0.0005</p2></calibration></sensor>"
        )
        pose = np.linalg.inv(view.cam_from_world)
        pose[:3, 3] = R.T @ (pose[:3, 3] - t) / scale
        pose[:3, :3] = R.T @ pose[:3, :3]
        matrix = "" if view.name == skip else f"<transform>{' '.join(map(repr, pose.ravel().tolist()))}</transform>"
        camera = f'<camera id="{n}" sensor_id="{n}" label="{Path(view.name).stem}">{matrix}</camera>'
        cameras += f'<group id="{n}">{camera}</group>' if n % 3 == 1 else camera

    def text(values: NDArray[np.float64]) -> str:
        return " ".join(map(repr, values.ravel().tolist()))

    return (
        '<?xml version="1.0" encoding="UTF-8"?><document version="2.0.0"><chunk label="Chunk 1">'
        f"<sensors>{sensors}</sensors><cameras>{cameras}</cameras>"
        f"<transform><rotation>{text(R)}</rotation><translation>{text(t)}</translation><scale>{scale!r}</scale></transform>"
        f"<region><center>{text(R.T @ (scene.bounds.center - t) / scale)}</center>"
        f"<size>{text(scene.bounds.extent / scale)}</size><R>{text(R.T)}</R></region></chunk></document>"
    )


def write_opencv(scene: Scene, file: Path, *, form: str = "{word}_{stem}", distortion: Sequence[float] = ()) -> None:
    """OpenCV's FileStorage of one K, with rvec and tvec of each view."""
    file.parent.mkdir(parents=True, exist_ok=True)
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", scene.views[0].K)
    storage.write("distortion_coefficients", np.array(distortion or [0.0] * 5))
    for n, view in enumerate(scene.views):
        for word, value in (
            ("rvec", cv2.Rodrigues(view.cam_from_world[:3, :3])[0]),
            ("tvec", view.cam_from_world[:3, 3]),
        ):
            storage.write(form.format(word=word, stem=Path(view.name).stem, n=n), value)
    storage.release()
