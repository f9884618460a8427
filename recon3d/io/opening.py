"""Scenes from folders of calibrated photographs, whatever their format."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d

from recon3d.errors import ArgumentError, DataError
from recon3d.io.alicevision import is_alicevision, read_alicevision
from recon3d.io.backdrop import before_backdrop, check_foreground, with_box_of_foreground
from recon3d.io.bouguet import is_bouguet, read_bouguet
from recon3d.io.bundler import is_bundler, read_bundler
from recon3d.io.calibrated import Calibrated
from recon3d.io.calibration_record import is_calibration, read_calibration
from recon3d.io.checking import check_box, not_in_images, warn_of_silhouettes, with_one_white
from recon3d.io.colmap import is_colmap, read_colmap
from recon3d.io.handedness import MIRROR, mirrored
from recon3d.io.matrices import is_matrices, read_matrices
from recon3d.io.metashape import is_metashape, read_metashape
from recon3d.io.middlebury import is_middlebury, read_middlebury, read_padded_bounds, read_unit
from recon3d.io.mvsnet import is_mvsnet, read_mvsnet
from recon3d.io.neus import is_neus, read_neus
from recon3d.io.open3d_cameras import is_open3d, read_open3d
from recon3d.io.opencv_storage import is_opencv_storage, read_opencv_storage
from recon3d.io.openmvg import is_openmvg, read_openmvg
from recon3d.io.photographs import image_files
from recon3d.io.strecha import is_strecha, read_strecha
from recon3d.io.transforms import is_transforms, read_transforms
from recon3d.io.unknown import told_unknown
from recon3d.scene.bounds import Bounds
from recon3d.scene.enclosing import FROM_CAMERAS, enclosing_box
from recon3d.scene.image_file import ImageFile
from recon3d.scene.mask import FileMask, Mask
from recon3d.scene.mask_files import fitting_masks, mask_folders, masks_of_views
from recon3d.scene.names import stems_of
from recon3d.scene.scene import NO_SILHOUETTES, Scene
from recon3d.scene.seeded import FEWEST_SEEDS, seeds_of, with_seeded_silhouettes
from recon3d.scene.segmentation import with_segmented_silhouettes
from recon3d.scene.silhouettes import with_mask_files, with_threshold_silhouettes
from recon3d.scene.view import View


class Format(NamedTuple):
    """How a scene format is recognised and read."""

    recognises: Callable[[Path], bool]
    read: Callable[..., Calibrated]
    """Of a path and, where photographs may lie elsewhere, their folder ``images``."""
    sign: str
    images_elsewhere: bool = False


FORMATS: dict[str, Format] = {
    "middlebury": Format(is_middlebury, read_middlebury, "a folder with a *_par.txt (Middlebury)", True),
    "calibrated": Format(is_calibration, read_calibration, "calibration.json (recon3d calibrate)"),
    "colmap": Format(is_colmap, read_colmap, "cameras and images, .bin or .txt (COLMAP)", True),
    "transforms": Format(is_transforms, read_transforms, "transforms.json (nerfstudio, instant-ngp, Blender)"),
    "neus": Format(is_neus, read_neus, "cameras_sphere.npz (IDR, NeuS)", True),
    "mvsnet": Format(is_mvsnet, read_mvsnet, "cams/*_cam.txt (MVSNet)"),
    "metashape": Format(is_metashape, read_metashape, "cameras.xml (Metashape)", True),
    "open3d": Format(is_open3d, read_open3d, "a PinholeCameraTrajectory (Open3D)"),
    "opencv": Format(is_opencv_storage, read_opencv_storage, "K, rvec and tvec as YAML or XML (OpenCV)", True),
    "openmvg": Format(is_openmvg, read_openmvg, "sfm_data.json (OpenMVG)", True),
    "alicevision": Format(is_alicevision, read_alicevision, "cameras.sfm or sfm.json (AliceVision, Meshroom)", True),
    "strecha": Format(is_strecha, read_strecha, "*.camera (Strecha)", True),
    "bouguet": Format(is_bouguet, read_bouguet, "Calib_Results.m (Bouguet)", True),
    "matrices": Format(is_matrices, read_matrices, "3x4 projection matrices, .txt, .npy or .mat (PMVS, VGG)", True),
    "bundler": Format(is_bundler, read_bundler, "bundle.out (Bundler)", True),
}

_MADE = {
    "auto": with_segmented_silhouettes,
    "segmented": with_segmented_silhouettes,
    "threshold": with_threshold_silhouettes,
}

_FEWEST = 3  # views that are looked at, however large


def open_scene(
    path: Path | str,
    *,
    bounds: Bounds | o3d.geometry.AxisAlignedBoundingBox | None = None,
    silhouettes: str | Path = "auto",
    mm_per_unit: float | None = None,
    images: str | Path | None = None,
    object_alone: bool = False,
) -> Scene:
    """Open a folder of calibrated photographs, whatever its format; pixels are read when they are asked for.

    Parameters
    ----------
    bounds : the object's box in the scene's own world frame. When None: the format's own, or that of a README beside,
        or one that is found from the silhouettes, from the format's points, or from what most cameras see.
    silhouettes : "auto": the scene's own masks where it has some (of the format, in a folder ``masks`` or
        ``silhouettes``, or the photographs' own opacity), else "none" where the background has many colors and
        "segmented" where not; "segmented": made by GrabCut, from a background of one color, or, where it has many,
        around the format's sparse points; "threshold": made from a dark one by the recipe of dinoSparseRing's README;
        both of all views or of those that the scene says have good ones; "none"; or a folder of masks.
    mm_per_unit : millimetres in one world unit; what the README of ``write_scene`` or the format says when None. Most
        formats have no unit: then no scale is known, and nothing is said in millimetres.
    images : folder of the photographs, where they do not lie with the cameras.
    object_alone : where the box is found from the format's points, leave out the table or the ground that the object
        stands on; the note "bounds" tells whether one was recognised.

    Raises
    ------
    ArgumentError : the format names its photographs itself, and `images` are given; or `bounds`, and `object_alone`.
    DataError : nothing there, of no known format, or a file is missing or malformed; names file and line.
    SceneError : the box does not fit the cameras or cuts the object off.
    """
    if object_alone and bounds is not None:
        raise ArgumentError("the bounds are given (--bounds): no table can be left out of them (--object)")
    path = Path(path)
    found = read_calibrated(path, images)
    named = str(silhouettes) not in (*_MADE, "none")
    views = views_of(found)
    masks, told_masks = _own_masks(found, views, path) if silhouettes == "auto" else ({}, {})
    views = tuple(replace(view, mask=masks.get(view.name)) for view in views)
    readme, told_unit = _told_in_readme(found, views, path)
    unit = next((mm for mm in (mm_per_unit, told_unit) if mm is not None), found.mm_per_unit)
    box, told_box = (
        (Bounds.of(bounds), {}) if bounds is not None else _own_bounds(found, views, readme, object_alone=object_alone)
    )
    scene = Scene(
        views,
        box,
        found.name,
        unit,
        {
            **found.notes,
            **({} if told_unit is None else {"unit": "that of the README"}),
            **({"unit": "not known; mm_per_unit (--mm-per-unit) gives millimetres"} if unit is None else {}),
            **told_masks,
            **told_box,
            "source": str(path.resolve()),
            "silhouettes from": str(Path(silhouettes).resolve() if named else silhouettes),
            **({} if images is None else {"images from": str(Path(images).resolve())}),
        },
    )
    check_box(scene)
    if named or masks:
        scene = with_mask_files(scene, silhouettes) if named else scene
        warn_of_silhouettes(scene)
        return scene
    if silhouettes == "none":
        return scene
    if silhouettes == "auto" and not before_backdrop(scene):
        return replace(scene, notes={**scene.notes, NO_SILHOUETTES: "the background has many colors"})
    if silhouettes == "auto" and told_box:  # neither the box nor the background is sure
        if not check_foreground(scene, must_fit=False, otherwise="; no silhouettes are made"):
            return scene
        enclosed = with_box_of_foreground(scene) if FROM_CAMERAS in told_box["bounds"] else scene
        return with_segmented_silhouettes(enclosed, only=found.masked)
    if silhouettes == "segmented" and found.points is not None and not before_backdrop(scene):
        seeds = seeds_of(found.points, scene.bounds)
        if len(seeds) >= FEWEST_SEEDS:
            told = f"cut out of a background of many colors around {len(seeds)} sparse points: look at them"
            scene = replace(scene, notes={**scene.notes, "masks": told})
            return with_seeded_silhouettes(scene, seeds, only=found.masked)
    check_foreground(scene, must_fit=bounds is None and not told_box, dark=silhouettes == "threshold")
    return _MADE[str(silhouettes)](scene, only=found.masked)


def read_calibrated(path: Path | str, images: Path | str | None = None) -> Calibrated:
    """Cameras, photographs and what else the files of a scene say, whether or not they fit together.

    Parameters
    ----------
    images : folder of the photographs, where they do not lie with the cameras.

    Raises
    ------
    ArgumentError : the format names its photographs itself, and `images` are given.
    DataError : nothing there, of no known format, or a file is missing or malformed; names file and line.
    """
    path = Path(path)
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    known = format_of(path)
    if known is None:
        raise DataError(told_unknown(path, [known.sign for known in FORMATS.values()]))
    return with_one_white(_right_handed(_read(known, path, None if images is None else Path(images)), path))


def views_of(found: Calibrated) -> tuple[View, ...]:
    """Views of what the files of a scene say, without masks."""
    return tuple(View(image.camera, image.photograph, None, image.name) for image in found.images)


def format_of(path: Path) -> Format | None:
    """The format of what lies at a path, or None."""
    return next((known for known in FORMATS.values() if known.recognises(path)), None)


def _read(known: Format, path: Path, images: Path | None) -> Calibrated:
    """What the files of a format say, of photographs in a folder of their own where one is given."""
    if images is None:
        return known.read(path)
    if not known.images_elsewhere:
        others = "; ".join(other.sign for other in FORMATS.values() if other.images_elsewhere)
        raise ArgumentError(f"{path}: images in another folder can be given for {others}, got {known.sign}")
    if not images.is_dir():
        raise DataError(f"{images}: expected a folder of photographs")
    return known.read(path, images)


def _right_handed(found: Calibrated, path: Path) -> Calibrated:
    """The same with bounds and points in the world of the cameras; says where it is the mirror image of the files'."""
    if not found.left_handed:
        return found
    warnings.warn(
        f"{path}: the world of these cameras is left-handed: it is mirrored, z is turned over. Bounds that you give "
        "are those of the mirrored world",
        stacklevel=3,
    )
    return replace(
        found,
        bounds=None if found.bounds is None else mirrored(found.bounds),
        points=None if found.points is None else found.points @ MIRROR[:3, :3],
        notes={**found.notes, "world": "left-handed in the files, mirrored: z is turned over"},
    )


def _own_masks(found: Calibrated, views: tuple[View, ...], path: Path) -> tuple[Mapping[str, Mask], dict[str, str]]:
    """The scene's own masks by the views' names, and a note of where they are; empty where there are none."""
    good = [view for view in views if found.masked is None or view.name in found.masked]
    own = {image.name: image.mask for image in found.images if image.mask is not None}
    if own:
        return fitting_masks(good, own), {"masks": f"{len(own)} of {len(views)} views, named by the format"}
    stems_by_name = stems_of(view.name for view in good)
    stems = [stems_by_name[view.name] for view in good]
    beside = _places(found, path)
    folders = [(folder, False) for folder in mask_folders(beside)] + [(folder, True) for folder in beside[:1]]
    for folder, marked in folders:
        files = masks_of_views(good, stems, folder, marked=marked)
        if files:
            return fitting_masks(good, files), {"masks": f"{len(files)} of {len(views)} views, {folder.name}"}
        if not marked and (others := image_files(folder)):
            warnings.warn(
                f"{folder}: none of its {len(others)} images ({others[0].name}) is named like a view "
                f"({', '.join(view.name for view in good[:1])}): no masks are taken from it",
                stacklevel=3,
            )
    opaque = {view.name: view.photograph.source for view in good if isinstance(view.photograph.source, ImageFile)}
    if opaque and all(file.has_alpha for file in opaque.values()):
        looked_at = np.linspace(0, len(opaque) - 1, min(_FEWEST, len(opaque))).round().astype(int)
        if any(list(opaque.values())[n].decode_alpha().min() < 128 for n in looked_at):
            alpha = {name: FileMask(file, alpha=True) for name, file in opaque.items()}
            return alpha, {"masks": f"{len(alpha)} of {len(views)} views, the photographs' opacity"}
    return {}, {}


def _places(found: Calibrated, path: Path) -> list[Path]:
    """Folders in which a scene's masks or its README may lie: of its photographs, the one above, and its own."""
    sources = [image.photograph.source for image in found.images]
    folders = [source.path.parent for source in sources if isinstance(source, ImageFile)]
    own = path if path.is_dir() else path.parent
    return list(dict.fromkeys([*folders[:1], *(folder.parent for folder in folders[:1]), own.absolute()]))


def _told_in_readme(found: Calibrated, views: tuple[View, ...], path: Path) -> tuple[Bounds | None, float | None]:
    """Box and millimetres in a world unit that a README says, if it is of this world: of a box in the images."""
    for folder in _places(found, path)[::-1]:
        try:
            box = read_padded_bounds(folder)
        except DataError:
            continue
        box = mirrored(box) if found.left_handed else box
        if not_in_images(views, box) is None:  # else it is of another frame, as of a set that was calibrated anew
            return box, read_unit(folder)
    return None, None


def _own_bounds(
    found: Calibrated, views: tuple[View, ...], readme: Bounds | None, *, object_alone: bool
) -> tuple[Bounds, dict[str, str]]:
    """The box of the format, or that of a README or one that is found, and then a note of which."""
    kept = "; no table was looked for" if object_alone else ""
    if found.bounds is not None:
        told = f"{found.bounds_from or ('those of the format' if kept else '')}{kept}"
        return found.bounds, {"bounds": told} if told else {}
    if readme is not None:
        return readme, {"bounds": f"those of the README{kept}"}
    box, how = enclosing_box(views, found.points, object_alone=object_alone)
    return box, {"bounds": f"{box.text}, {how}{f' ({found.no_bounds})' if found.no_bounds else ''}"}
