"""Measure reconstructions of the built-in scene against its exact surface, whole and where two views show it.

Usage: python scripts/measure_built_in.py [--noise LEVELS] [--light-change SHARE] [--views N] [--surface NAME]

Accuracy is of the measured surface alone.
"""

from typing import Annotated

import numpy as np
import open3d as o3d
import trimesh
import typer

import recon3d
from recon3d.rendering.ray_caster import RayCaster

EDGE = 2.0  # pixel footprints of the triangles that are seen or not


def seen_by_two(built_in: recon3d.datasets.BuiltInScene) -> tuple[o3d.geometry.TriangleMesh, np.ndarray]:
    """The exact surface in small triangles, and which of these two views or more show (n_triangles,)."""
    truth, scene = built_in.ground_truth, built_in.scene
    vertices, triangles = trimesh.remesh.subdivide_to_size(
        np.asarray(truth.vertices), np.asarray(truth.triangles), EDGE * scene.pixel_footprint
    )
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(triangles))
    mesh.compute_triangle_normals()
    # The centre of every triangle stands for it.
    centers = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices[triangles].mean(axis=1)), o3d.utility.Vector3iVector()
    )
    centers.vertex_normals = mesh.triangle_normals
    visibility = recon3d.surface.VertexVisibility.of(centers, scene, RayCaster(truth))
    return mesh, visibility.n_views >= 2


def main(
    noise: Annotated[float, typer.Option(help="Standard deviation, grey levels.")] = 4.0,
    light_change: Annotated[float, typer.Option(help="Standard deviation of each view's exposure, a share.")] = 0.08,
    views: int = 16,
    surface: str = "poisson",
) -> None:
    """Print accuracy at 90% and completeness at 1.25 mm and at half a pixel's footprint."""
    built_in = recon3d.little_temple(n_views=views, noise=noise, light_change=light_change)
    result = recon3d.reconstruct(
        built_in.scene, recon3d.Settings(meshing=recon3d.Meshing(surface=surface, keep_unsupported=False))
    )
    truth, seen = seen_by_two(built_in)
    half = built_in.scene.pixel_footprint * built_in.scene.mm_per_unit / 2
    measured = recon3d.evaluate(result.mesh, truth, valid=seen, spacing=half / 2000)
    whole = recon3d.evaluate(result.mesh, truth, spacing=half / 2000)
    print(f"half a pixel's footprint {half:.3f} mm; two views or more show {seen.mean():.1%} of the triangles")
    print(f"accuracy (90%)            {measured.accuracy_mm:.3f} mm; median {measured.accuracy_at(50):.3f} mm")
    print(f"within half a footprint   {np.mean(measured.accuracy_distances <= half):.1%} of the mesh")
    print(f"completeness (1.25 mm)    {measured.completeness_percent:.1f}%; of all {whole.completeness_percent:.1f}%")
    print(f"seconds                   {sum(result.timings.values()):.1f}")


if __name__ == "__main__":
    typer.run(main)
