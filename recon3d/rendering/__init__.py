"""Pictures of meshes by ray casting."""

from recon3d.rendering.renderer import Renderer, Rendering, render
from recon3d.rendering.sheets import comparison_sheet, turntable

__all__ = [
    "Renderer",
    "Rendering",
    "comparison_sheet",
    "render",
    "turntable",
]
