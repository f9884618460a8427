"""How a mesh is made of what carving and matching found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from recon3d.checks import require_choice, require_flag, require_number, require_whole
from recon3d.surface.poisson import Surface


@dataclass(frozen=True)
class Meshing:
    """How a mesh is made: of the points that dense matching found, or of the voxels where nothing was matched."""

    surface: Surface = "poisson"
    """Of points: "poisson" or "graph-cut"."""
    keep_unsupported: bool = True
    """Keep surface that nothing was measured of, such as the underside that no view sees, so that the mesh is closed.
    Surface of voxels is measured where a view sees it, surface of points where two views found it."""
    fill_hidden: bool = False
    """Of voxels carved by a one-sided method: mesh what lies hidden behind them, too; solid, but partly guessed."""
    smoothing: int | None = None
    """Of voxels: pairs of Taubin steps; 0: none, 5 when None."""
    min_component: float = 100.0
    """Area, in faces of a voxel, below which a separate piece of the mesh is a small component and dropped; 100 is the
    surface of four voxels cubed, 0 keeps all."""

    def __post_init__(self) -> None:
        require_choice("surface", self.surface, get_args(Surface))
        require_flag("keep_unsupported", self.keep_unsupported)
        require_flag("fill_hidden", self.fill_hidden)
        if self.smoothing is not None:
            require_whole("smoothing", self.smoothing, least=0)
        require_number("min_component", self.min_component, "[0, inf)")
