"""Compare textures with colours of vertices, and with Open3D's, by photographs that were left out.

Usage: python scripts/study_textures.py RENDERED SCENE [--mesh FILE] [--size N] [--pictures DIR]

SCENE is cow_black, cow_white, cow_room or figure_white, folders of RENDERED, or little-temple, the built-in scene with
noise and exposures that differ. Of every six views one is left out of the reconstruction and of the colours. Each way
to colour the mesh is rendered from the views that were left out, with three by three rays a pixel, its exposure fitted
channel by channel; differences and SSIM are over the pixels that show the mesh and lie in the mask.
"""

from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Annotated

import cv2
import numpy as np
import open3d as o3d
import typer
from skimage.metrics import structural_similarity

import recon3d
from recon3d.rendering.renderer import Renderer
from recon3d.rendering.texture import Texture
from recon3d.surface.texture import TexturedMesh, texture_mesh

EVERY = 6  # views, of which one is left out
RAYS = 3  # for a pixel, in each direction


def opened(rendered: Path, name: str) -> recon3d.Scene:
    """A scene by its name."""
    if name == "little-temple":
        return recon3d.little_temple(noise=2.0, light_change=0.08).scene
    return recon3d.open_scene(rendered / name, silhouettes=rendered / name / "masks")


def by_open3d(textured: TexturedMesh, scene: recon3d.Scene, size: int) -> Texture:
    """The texture that Open3D makes of the same charts."""
    mesh = o3d.t.geometry.TriangleMesh.from_legacy(textured.mesh)
    mesh.triangle.texture_uvs = o3d.core.Tensor.from_numpy(textured.texture.places.astype(np.float32))
    images = [o3d.t.geometry.Image(np.ascontiguousarray(view.image)) for view in scene.views]
    K = [o3d.core.Tensor(view.K) for view in scene.views]
    poses = [o3d.core.Tensor(view.cam_from_world) for view in scene.views]
    albedo = mesh.project_images_to_albedo(images, K, poses, size).as_tensor().numpy()
    return Texture(textured.texture.places, np.ascontiguousarray(albedo[::-1, :, :3]))  # its v runs upwards


def picture(renderer: Renderer, view: recon3d.View) -> tuple[np.ndarray, np.ndarray]:
    """(height, width, 3) rendering, 0 to 255, and (height, width) whether all of a pixel shows the mesh."""
    fine = np.array([[RAYS, 0, (RAYS - 1) / 2], [0, RAYS, (RAYS - 1) / 2], [0, 0, 1.0]])
    seen = renderer.cast(fine @ view.K, view.cam_from_world, RAYS * view.width, RAYS * view.height)
    size = (view.width, view.height)
    colors = cv2.resize(255 * renderer.colors(seen), size, interpolation=cv2.INTER_AREA)
    return colors, cv2.resize(seen.hit.astype(np.float64), size, interpolation=cv2.INTER_AREA) > 0.999


def measured(renderer: Renderer, views: tuple[recon3d.View, ...], pictures: Path | None) -> tuple[float, float]:
    """Mean absolute difference, grey levels, and SSIM."""
    differences, similarities = [], []
    for view in views:
        shown, whole = picture(renderer, view)
        compared = whole & view.may_show_object
        photograph = view.image.astype(np.float64)
        for channel in range(3):
            mine, theirs = shown[..., channel][compared], photograph[..., channel][compared]
            shown[..., channel] *= np.median(theirs / np.maximum(mine, 1))
        shown = np.clip(shown, 0, 255)
        differences.append(np.abs(shown - photograph)[compared].mean(axis=1))
        beside = ~compared[..., None]
        _, similarity = structural_similarity(
            np.where(beside, 0, shown), np.where(beside, 0, photograph), data_range=255, channel_axis=2, full=True
        )
        similarities.append(similarity[compared].mean(axis=1))
        if pictures is not None:
            both = np.hstack([np.where(beside, 255, shown), np.where(beside, 255, photograph)])
            recon3d.io.files.write_image(pictures / f"{view.name}.png", np.rint(both).astype(np.uint8))
    return float(np.concatenate(differences).mean()), float(np.concatenate(similarities).mean())


def timed(make: Callable[[], object]) -> tuple[object, float]:
    """What is made, and CPU seconds."""
    start = process_time()
    made = make()
    return made, process_time() - start


def main(
    rendered: Path,
    scene: str,
    mesh: Annotated[
        Path | None, typer.Option(help="Made of the views that are not left out; made anew if none.")
    ] = None,
    size: int = 2048,
    triangles: int = 50_000,
    voxels: int = 200_000,
    open3d: bool = True,
    pictures: Path | None = None,
) -> None:
    """Print a row for each way to colour a mesh."""
    whole = opened(rendered, scene)
    left_out = tuple(view for n, view in enumerate(whole.views) if n % EVERY == 2)
    used = whole.subset([view.name for view in whole.views if view not in left_out])
    shape = recon3d.read_mesh(mesh) if mesh else recon3d.reconstruct(used, recon3d.Settings(n_voxels=voxels)).mesh
    colored, seconds = timed(lambda: recon3d.color(shape, used))
    renderers = {f"vertices ({len(shape.triangles):,} triangles)": (Renderer(colored), seconds)}
    few = recon3d.surface.decimate(shape, triangles).mesh
    colored, seconds = timed(lambda: recon3d.color(few, used))
    renderers[f"vertices ({len(few.triangles):,} triangles)"] = (Renderer(colored), seconds)
    textured, seconds = timed(lambda: texture_mesh(shape, used, size=size, triangles=triangles))
    renderers[f"texture ({size})"] = (Renderer(textured.mesh, texture=textured.texture), seconds)
    if open3d:
        texture, seconds = timed(lambda: by_open3d(textured, used, size))
        renderers[f"Open3D ({size})"] = (Renderer(textured.mesh, texture=texture), seconds)
    for name, (renderer, seconds) in renderers.items():
        folder = None if pictures is None else pictures / name.split(" (")[0]
        difference, similarity = measured(renderer, left_out, folder)
        print(f"| {scene} | {name} | {difference:.2f} | {similarity:.4f} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    typer.run(main)
