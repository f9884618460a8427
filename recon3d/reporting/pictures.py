"""Pictures of results as files: beside the photographs, from all around, and maps of errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d

from recon3d.io.files import write_image
from recon3d.io.geometry import write_geometry
from recon3d.io.reading_geometry import read_mesh
from recon3d.rendering.renderer import Renderer
from recon3d.rendering.sheets import comparison_sheet, turntable
from recon3d.reporting.error_maps import error_map
from recon3d.scene.names import file_stems
from recon3d.scene.scene import Scene


def save_error_maps(
    reconstruction: Path | str,
    ground_truth: Path | str,
    folder: Path | str,
    *,
    mm_per_unit: float = 1000.0,
    full_scale_mm: float = 5.0,
) -> dict[str, Path]:
    """Write two mesh files' mutual error maps as PLY and as one picture; returns role to path.

    In the picture's upper row the reconstruction's distance to the ground truth, in the lower row the ground truth's
    to the reconstruction: what is wrong, and what is missing.
    """
    folder = Path(folder)
    first, second = read_mesh(reconstruction), read_mesh(ground_truth)
    scale = {"mm_per_unit": mm_per_unit, "full_scale_mm": full_scale_mm}
    wrong, missing = error_map(first, second, **scale), error_map(second, first, **scale)
    strips = [turntable(None, Renderer(mesh), frames=6) for mesh in (wrong, missing)]
    return {
        "errors": write_geometry(folder / "error_map.ply", wrong),
        "missing": write_geometry(folder / "missing_map.ply", missing),
        f"error maps (red: {full_scale_mm:g} mm)": write_image(folder / "error_map.png", np.vstack(strips)),
    }


def save_pictures(
    mesh: o3d.geometry.TriangleMesh, scene: Scene, folder: Path | str, *, every_view: bool = False
) -> dict[str, Path]:
    """Render a mesh beside the photographs, and from all around; returns role to path.

    Parameters
    ----------
    every_view : also write each view's coloured, shaded, normals and depth pictures into ``views/``, and compare all
        views instead of four.
    """
    folder = Path(folder)
    renderer = Renderer(mesh)
    shown = len(scene.views) if every_view else 4
    written = {
        "comparison": write_image(folder / "comparison.png", comparison_sheet(scene, renderer, views=shown)),
        "turntable": write_image(folder / "turntable.png", turntable(scene, renderer)),
    }
    if every_view:
        stems = file_stems(scene)
        for view in scene.views:
            for mode, picture in renderer.render_view(view).pictures().items():
                write_image(folder / "views" / f"{stems[view.name]}_{mode}.png", picture)
        written["views"] = folder / "views"
    return written
