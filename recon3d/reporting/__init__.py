"""What a run leaves for people to see: plots, pictures, pages."""

from recon3d.reporting.error_maps import error_map
from recon3d.reporting.figures import plot_evaluation, save_evaluation, show_mesh
from recon3d.reporting.pictures import save_error_maps, save_pictures
from recon3d.reporting.saving import save
from recon3d.reporting.uncertainty_maps import save_uncertainty, uncertainty_map

__all__ = [
    "error_map",
    "plot_evaluation",
    "save",
    "save_error_maps",
    "save_evaluation",
    "save_pictures",
    "save_uncertainty",
    "show_mesh",
    "uncertainty_map",
]
