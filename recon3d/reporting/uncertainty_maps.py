"""A mesh coloured by how far it may be from the true surface."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.io.files import write_image
from recon3d.rendering.renderer import Renderer
from recon3d.rendering.sheets import turntable
from recon3d.scene.names import file_stems
from recon3d.scene.scene import Scene

_FILLED = (0.6, 0.6, 0.6)  # colour of what was not measured
_SHARE = 0.95  # of the measured vertices lies within the scale
_BAR = (24, 16, 96)  # height of the colour bar, space around it, width of a number, pixels


def full_scale(uncertainty: NDArray[np.float64]) -> float:
    """Uncertainty (n_vertices,) that 95% of the measured vertices do not exceed, rounded up to 1, 2 or 5 times 10^n.

    World units; 1 where nothing was measured.
    """
    finite = uncertainty[np.isfinite(uncertainty)]
    largest = float(np.quantile(finite, _SHARE)) if len(finite) else 0.0
    if largest <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= largest * (1 - 1e-9)))


def uncertainty_map(
    mesh: o3d.geometry.TriangleMesh, uncertainty: NDArray[np.float64], scale: float
) -> o3d.geometry.TriangleMesh:
    """The mesh with vertices coloured by their uncertainty (n_vertices,), from blue (0) to red (scale and more).

    What was filled, whose uncertainty is infinite, is grey.
    """
    from matplotlib import colormaps

    if not 0 < scale < np.inf:
        raise ArgumentError(f"expected a positive scale of the uncertainty, got {scale}")
    if uncertainty.shape != (len(mesh.vertices),):
        raise ArgumentError(
            f"expected the uncertainty of each of {len(mesh.vertices):,} vertices, got shape {uncertainty.shape}"
        )
    measured = np.isfinite(uncertainty)
    shades = np.empty((len(uncertainty), 3))
    shades[measured] = colormaps["turbo"](np.clip(uncertainty[measured] / scale, 0, 1))[:, :3]
    shades[~measured] = _FILLED
    colored = o3d.geometry.TriangleMesh(mesh)
    colored.vertex_colors = o3d.utility.Vector3dVector(shades)
    return colored


def with_legend(picture: NDArray[np.uint8], scene: Scene, scale: float) -> NDArray[np.uint8]:
    """A picture (height, width, 3) of an uncertainty map above the scale of its colours, from 0 to ``scale``.

    Numbers are in millimetres, or in world units where the scene has no scale.
    """
    from matplotlib import colormaps

    bar, space, text = _BAR
    width = max(picture.shape[1], 6 * text)
    legend = np.full((bar + 3 * space, width, 3), 255, np.uint8)
    left, right = text // 2, width - 3 * text
    ramp = colormaps["turbo"](np.linspace(0, 1, right - left))[:, :3]
    legend[space // 2 : space // 2 + bar, left:right] = np.rint(255 * ramp)
    box = right + text, right + text + bar
    legend[space // 2 : space // 2 + bar, box[0] : box[1]] = np.rint(255 * np.array(_FILLED))

    def write(words: str, x: int, y: int) -> None:
        cv2.putText(legend, words, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)

    for share in (0, 0.5, 1):
        write(scene.length(share * scale), left + round(share * (right - left)) - text // 3, bar + 2 * space)
    write("not measured", box[0], bar + 2 * space)
    padded = np.full((picture.shape[0], width, 3), 255, np.uint8)
    padded[:, : picture.shape[1]] = picture
    return np.vstack([padded, legend])


def save_uncertainty(
    mesh: o3d.geometry.TriangleMesh,
    uncertainty: NDArray[np.float64],
    scene: Scene,
    folder: Path | str,
    *,
    scale: float | None = None,
) -> dict[str, Path]:
    """Picture a mesh's uncertainty (n_vertices,) from all around and from every view, with its scale of colours.

    Parameters
    ----------
    scale : uncertainty that is red, world units; ``full_scale`` when None.

    Returns
    -------
    dict
        What was written: role to path.
    """
    folder, red = Path(folder), full_scale(uncertainty) if scale is None else scale
    renderer = Renderer(uncertainty_map(mesh, uncertainty, red))
    around = turntable(scene, renderer)
    written = {"uncertainty": write_image(folder / "uncertainty.png", with_legend(around, scene, red))}
    stems = file_stems(scene)
    for view in scene.views:
        picture = with_legend(renderer.render_view(view).picture(), scene, red)
        write_image(folder / "views" / f"{stems[view.name]}_uncertainty.png", picture)
    return written | {"views": folder / "views"}
