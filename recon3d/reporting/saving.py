"""A result as a folder of files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from recon3d.errors import ArgumentError
from recon3d.io.files import remove_leftovers, write_json
from recon3d.io.geometry import MESH_SUFFIXES, write_geometry
from recon3d.reporting.pictures import save_pictures
from recon3d.result import Reconstruction


def save(
    result: Reconstruction, folder: Path | str, *, mesh_formats: Sequence[str] = ("ply",), pictures: bool = True
) -> dict[str, Path]:
    """Write a result's meshes, points, voxels, pictures and the record into a folder; each file whole or not at all.

    Parameters
    ----------
    mesh_formats : of "ply", "obj", "glb", "stl".
    pictures : whether to render the comparison with the photographs and the turntable.

    Returns
    -------
    dict
        What was written: role to path.
    """
    folder = Path(folder)
    known = [suffix[1:] for suffix in MESH_SUFFIXES]
    unknown = [name for name in mesh_formats if name not in known]
    if unknown:
        raise ArgumentError(f"expected mesh formats among {', '.join(known)}, got {', '.join(unknown)}")
    # The record tells a finished result: it goes first and comes last.
    record = result.record()
    (folder / "record.json").unlink(missing_ok=True)
    remove_leftovers(folder)
    written = {
        f"mesh ({name})": write_geometry(
            folder / f"mesh.{name}", result.mesh, support=result.support, uncertainty=result.uncertainty
        )
        for name in mesh_formats
    }
    written["points"] = write_geometry(folder / "points.ply", result.points, confidence=result.confidence)
    written["voxel grid"] = write_geometry(folder / "voxels.ply", result.carved.to_voxel_grid())
    if pictures:
        written |= save_pictures(result.mesh, result.scene, folder)
    written["figures"] = write_json(folder / "record.json", record)
    return written
