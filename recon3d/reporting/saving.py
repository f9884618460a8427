"""A result as a folder of files."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from recon3d.errors import ArgumentError
from recon3d.io.files import remove_leftovers, write_json
from recon3d.io.geometry import MESH_SUFFIXES, write_geometry
from recon3d.io.printing import PRINT_SUFFIXES, write_print
from recon3d.io.run_record import RECORD_FILE
from recon3d.rendering.orbit import upright
from recon3d.reporting.pictures import save_pictures
from recon3d.result import Reconstruction


def save(
    result: Reconstruction, folder: Path | str, *, mesh_formats: Sequence[str] = ("ply",), pictures: bool = True
) -> dict[str, Path]:
    """Write a result's meshes, points, voxels, pictures and the record into a folder; each file whole or not at all.

    Parameters
    ----------
    mesh_formats : of "ply", "obj", "glb", "stl", "3mf". The last two are for printing: millimetres where the scale is
        known, z up, standing on z = 0; the others are in the world's frame and unit.
    pictures : whether to render the comparison with the photographs and the turntable.

    Returns
    -------
    dict
        What was written: role to path.

    Raises
    ------
    ArgumentError : a mesh format is not known.
    OpenMeshError : a format for printing is asked for, and the mesh is open; all else was written.
    """
    folder = Path(folder)
    known = [suffix[1:] for suffix in dict.fromkeys((*MESH_SUFFIXES, *PRINT_SUFFIXES))]
    unknown = [name for name in mesh_formats if name not in known]
    if unknown:
        raise ArgumentError(f"expected mesh formats among {', '.join(known)}, got {', '.join(unknown)}")
    # The record tells a finished result: it goes first and comes last.
    record = result.record()
    (folder / RECORD_FILE).unlink(missing_ok=True)
    remove_leftovers(folder)
    written = {
        f"mesh ({name})": write_geometry(
            folder / f"mesh.{name}", result.mesh, support=result.support, uncertainty=result.uncertainty
        )
        for name in mesh_formats
        if f".{name}" not in PRINT_SUFFIXES
    }
    written["points"] = write_geometry(folder / "points.ply", result.points, confidence=result.confidence)
    written["voxel grid"] = write_geometry(folder / "voxels.ply", result.carved.to_voxel_grid())
    if pictures:
        written |= save_pictures(result.mesh, result.scene, folder)
    written["figures"] = write_json(folder / RECORD_FILE, record)
    return written | save_prints(result, folder, [name for name in mesh_formats if f".{name}" in PRINT_SUFFIXES])


def save_prints(result: Reconstruction, folder: Path | str, formats: Sequence[str]) -> dict[str, Path]:
    """Write a result's mesh for printing into a folder: millimetres, z up, standing on z = 0.

    Parameters
    ----------
    formats : of "stl", "3mf".

    Returns
    -------
    dict
        What was written: role to path.

    Raises
    ------
    OpenMeshError : the mesh is open.

    Warns
    -----
    UserWarning : the scene's scale is not known, so a world unit became a millimetre.
    """
    print_from_world = upright(result.scene, up="z", unit_mm=1.0)
    written = {
        f"mesh ({name})": write_print(Path(folder) / f"mesh.{name}", result.mesh, print_from_world) for name in formats
    }
    if written and result.scene.mm_per_unit is None:
        warnings.warn(
            f"scene {result.scene.name}: no scale is known, so a world unit became a millimetre in "
            f"{', '.join(path.name for path in written.values())}; give mm_per_unit (--mm-per-unit)",
            stacklevel=2,
        )
    return written
