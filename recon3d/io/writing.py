"""Scenes written in other programs' formats, so that the same programs, and ``open_scene``, read the same cameras.

Photographs are written undistorted, as PNG, with the views' silhouettes as masks, and a README holds the bounds and the
unit, which most formats have no place for. What a format's axes and pixels are is said by its reader's module.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.io.files import atomic_folder, write_image, write_json, write_text
from recon3d.io.middlebury import write_middlebury, write_readme
from recon3d.scene.camera import Camera
from recon3d.scene.names import file_stems
from recon3d.scene.scene import Scene
from recon3d.scene.view import View

_ROUNDING = 1e-3  # pixels by which skew may move a photograph's content without being undone
_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # to OpenGL's axes


class Writer(NamedTuple):
    """How a scene is written in a format."""

    write: Callable[[Scene, Path], object]
    """Into an empty folder."""
    skew: bool
    """Whether the format's cameras may have skew."""


def write_scene(scene: Scene, folder: Path | str, form: str = "colmap") -> Path:
    """Write a scene in another program's format, whole or not at all; returns the folder.

    Parameters
    ----------
    folder : new, or empty.
    form : one of ``WRITERS``. Photographs are straightened, with a warning, where the cameras have skew and the format
        has none.

    Raises
    ------
    ArgumentError : the folder holds something, the format is unknown or cannot hold the scene.
    """
    folder = Path(folder)
    if form not in WRITERS:
        raise ArgumentError(f"expected a format {', '.join(WRITERS)}, got {form!r}")
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise ArgumentError(f"{folder}: expected a new folder, or an empty one: readers would find both scenes in it")
    writer = WRITERS[form]
    if not writer.skew:
        scene = _without_skew(scene, form)
    with atomic_folder(folder) as made:
        writer.write(scene, made)
        write_readme(scene, made)
    return folder


def _write_colmap(scene: Scene, folder: Path) -> None:
    """``sparse/0`` as text, ``images``, and ``masks`` under COLMAP's names: ``view01.png.png``."""
    from scipy.spatial.transform import Rotation

    lenses: dict[str, int] = {}
    images = []
    for n, (view, stem) in enumerate(_stems(scene), start=1):
        fx, fy, cx, cy = _from_corner(view.K)
        lens = f"PINHOLE {view.width} {view.height} {_text([fx, fy, cx, cy])}"
        camera = lenses.setdefault(lens, len(lenses) + 1)
        quaternion = Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat(scalar_first=True)
        pose = _text([*quaternion, *view.cam_from_world[:3, 3]])
        images.append(f"{n} {pose} {camera} {stem}.png\n\n")
        _write_pictures(view, folder / "images" / f"{stem}.png", folder / "masks" / f"{stem}.png.png")
    model = folder / "sparse" / "0"
    cameras = (f"{n} {lens}\n" for lens, n in lenses.items())
    write_text(model / "cameras.txt", "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n" + "".join(cameras))
    write_text(model / "images.txt", "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n" + "".join(images))
    write_text(model / "points3D.txt", "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n")


def _write_transforms(scene: Scene, folder: Path) -> None:
    """``transforms.json``, ``images`` and ``masks``."""
    frames = []
    for view, stem in _stems(scene):
        fx, fy, cx, cy = _from_corner(view.K)
        image, mask = f"images/{stem}.png", f"masks/{stem}.png"
        frame: dict[str, Any] = {"file_path": image}
        if _write_pictures(view, folder / image, folder / mask):
            frame["mask_path"] = mask
        frame |= {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": view.width, "h": view.height}
        frame["transform_matrix"] = (np.linalg.inv(view.cam_from_world) @ _FROM_OPENCV).tolist()
        frames.append(frame)
    write_json(folder / "transforms.json", {"camera_model": "PINHOLE", "frames": frames})


def _write_neus(scene: Scene, folder: Path) -> None:
    """``cameras_sphere.npz``, ``image`` and ``mask``, numbered."""
    radius = float(np.linalg.norm(scene.bounds.extent)) / 2
    sphere = np.diag([radius, radius, radius, 1.0])
    sphere[:3, 3] = scene.bounds.center
    matrices: dict[str, NDArray[np.float64]] = {}
    for n, view in enumerate(scene.views):
        matrices |= {f"world_mat_{n}": np.vstack([view.projection, [0, 0, 0, 1]]), f"scale_mat_{n}": sphere}
        _write_pictures(view, folder / "image" / f"{n:06d}.png", folder / "mask" / f"{n:06d}.png")
    np.savez(folder / "cameras_sphere.npz", allow_pickle=False, **matrices)


def _write_middlebury(scene: Scene, folder: Path) -> None:
    """``*_par.txt``, the photographs and ``silhouettes``."""
    sizes = sorted({f"{view.width}x{view.height}" for view in scene.views})
    if len(sizes) > 1:
        raise ArgumentError(f"scene {scene.name}: a Middlebury set has photographs of one size, got {', '.join(sizes)}")
    write_middlebury(scene, folder)


def _write_open3d(scene: Scene, folder: Path) -> None:
    """A ``PinholeCameraTrajectory``, ``color`` and ``masks``, numbered."""
    version = {"version_major": 1, "version_minor": 0}
    cameras = []
    for n, view in enumerate(scene.views):
        intrinsic = {"width": view.width, "height": view.height, "intrinsic_matrix": view.K.T.ravel().tolist()}
        extrinsic = view.cam_from_world.T.ravel().tolist()
        named = {"class_name": "PinholeCameraParameters", **version}
        cameras.append({**named, "extrinsic": extrinsic, "intrinsic": intrinsic})
        _write_pictures(view, folder / "color" / f"{n:06d}.png", folder / "masks" / f"{n:06d}.png")
    content = {"class_name": "PinholeCameraTrajectory", "parameters": cameras, **version}
    write_json(folder / "trajectory.json", content)


WRITERS: dict[str, Writer] = {
    "colmap": Writer(_write_colmap, skew=False),
    "transforms": Writer(_write_transforms, skew=False),
    "neus": Writer(_write_neus, skew=True),
    "middlebury": Writer(_write_middlebury, skew=True),
    "open3d": Writer(_write_open3d, skew=True),
}
"""Formats that scenes are written in; each is read again by the reader of the same name."""


def _stems(scene: Scene) -> list[tuple[View, str]]:
    stems = file_stems(scene)
    return [(view, stems[view.name]) for view in scene.views]


def _from_corner(K: NDArray[np.float64]) -> list[float]:
    """fx, fy, cx, cy of pixels that are counted from the image's corner."""
    return [float(K[0, 0]), float(K[1, 1]), float(K[0, 2]) + 0.5, float(K[1, 2]) + 0.5]


def _text(values: list[float]) -> str:
    """Numbers to the last digit."""
    return " ".join(repr(float(value)) for value in values)


def _write_pictures(view: View, image: Path, mask: Path) -> bool:
    """Photograph and silhouette of a view, and whether it has one."""
    write_image(image, view.image)
    silhouette = view.silhouette
    if silhouette is not None:
        write_image(mask, silhouette)
    return silhouette is not None


def _without_skew(scene: Scene, form: str) -> Scene:
    """The scene as cameras without skew show it; photographs are resampled where that moves their content."""
    moved = [_moved(view) for view in scene.views]
    if max(moved) <= _ROUNDING:
        return scene
    warnings.warn(
        f"{scene.name}: the format {form} has no skew, which moves pixels by up to {max(moved):.2g} here: the "
        "photographs are resampled",
        stacklevel=3,
    )
    return replace(scene, views=tuple(map(_straight, scene.views)))


def _moved(view: View) -> float:
    """Pixels by which skew moves the content of a photograph at most."""
    K = view.K
    return float(abs(K[0, 1] / K[1, 1]) * max(abs(K[1, 2]), abs(view.height - 1 - K[1, 2])))


def _straight(view: View) -> View:
    """The view as a camera without skew shows it; what the photograph does not show may be object."""
    K = view.K
    straight = K * [[1, 0, 1], [1, 1, 1], [1, 1, 1]]
    old_from_new = (K @ np.linalg.inv(straight))[:2]
    size, flags = (view.width, view.height), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpAffine(view.image, old_from_new, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    silhouette = view.silhouette
    if silhouette is not None:
        grey = silhouette.astype(np.uint8) * np.uint8(255)
        silhouette = cv2.warpAffine(grey, old_from_new, size, flags=flags, borderValue=(255,)) > 127
    camera = Camera(straight, view.cam_from_world, *size)
    return View(camera, np.asarray(image, np.uint8), silhouette, view.name)
