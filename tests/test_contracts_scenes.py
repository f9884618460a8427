"""Scenes of other kinds than an object among cameras: without silhouettes, overflowing the images, from within."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from scenes import box_mesh, cropped, transformed

import recon3d
from recon3d.carving import METHODS
from recon3d.datasets.synthetic import photograph, temple_texture
from recon3d.errors import Recon3dError
from recon3d.rendering.orbit import look_at
from recon3d.scene.bounds import Bounds
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.settings import choose_views
from recon3d.stereo.refinement import _within


def unmasked(scene: Scene) -> Scene:
    return replace(scene, views=tuple(View(view.calibration, view.photograph, None, view.name) for view in scene.views))


@pytest.fixture(scope="module")
def temple() -> Scene:
    return unmasked(recon3d.datasets.little_temple(n_views=6, width=96, height=72, supersampling=1).scene)


@pytest.fixture(scope="module")
def room() -> Scene:
    """A room 0.4 wide, seen by cameras that look outwards from near its middle, all away from it."""
    walls = box_mesh(0.4, 0.3, 0.24)
    walls.triangles = o3d.utility.Vector3iVector(np.asarray(walls.triangles)[:, ::-1])
    cameras = []
    for angle in np.radians(np.arange(0, 360, 40)):
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        K = np.array([[55.0, 0, 47.5], [0, 55.0, 35.5], [0, 0, 1]])
        cameras.append(Camera(K, look_at(0.07 * out, out, np.array([0, 0, 1.0])), 96, 72))
    scene = unmasked(photograph(walls, temple_texture, cameras, supersampling=1))
    return replace(scene, bounds=Bounds((-0.21, -0.16, -0.13), (0.21, 0.16, 0.13)))


def overflowing(scene: Scene) -> Scene:
    """The middle of every photograph, which the object overflows."""
    views = []
    for view in scene.views:
        K = view.K - [[0, 0, 32], [0, 0, 24], [0, 0, 0]]
        whole = View.from_matrices(K, view.cam_from_world, view.image[24:, 32:].copy())
        views.append(replace(cropped(whole, 40, 30), name=view.name))
    return replace(scene, views=tuple(views))


@pytest.mark.parametrize("kind", ["without silhouettes", "overflowing", "from within"])
@pytest.mark.parametrize("name", METHODS)
def test_every_method_carves_any_scene_or_says_in_a_line_why_not(
    name: str, kind: str, temple: Scene, room: Scene
) -> None:
    scene = {"without silhouettes": temple, "overflowing": overflowing(temple), "from within": room}[kind]
    settings = recon3d.Settings(carving=METHODS[name](), n_voxels=3_000)
    refused = ""
    try:
        settings = settings.resolved(scene)
        scene = choose_views(scene, settings)
        carved = recon3d.carve(scene, settings.lattice(scene), settings.carving)
        assert 0 < carved.n_accepted < carved.lattice.n_voxels
    except Recon3dError as error:
        refused = str(error)
    assert bool(refused) >= METHODS[name].needs_silhouettes
    assert not refused or METHODS[name].needs_silhouettes or kind == "from within"
    assert not refused or (scene.name in refused and "\n" not in refused)


def test_duplicated_views_are_used_once(temple: Scene) -> None:
    first = temple.views[0]
    again = replace(first, name="again")
    other = replace(first, photograph=np.zeros_like(first.image), name="another photograph")
    doubled = replace(temple, views=(*temple.views, again, other))
    chosen = choose_views(doubled, recon3d.Settings())
    assert [view.name for view in chosen.views] == [*(view.name for view in temple.views), "another photograph"]
    assert len(choose_views(doubled, recon3d.Settings(views=(temple.views[0].name, "again"))).views) == 1
    assert choose_views(temple, recon3d.Settings()) == temple


def test_photographs_that_show_nothing_end_with_one_line(temple: Scene) -> None:
    blank = replace(
        temple, views=tuple(replace(view, photograph=np.full_like(view.image, 90)) for view in temple.views)
    )
    with pytest.raises(Recon3dError, match=r"little-temple") as refused:
        recon3d.reconstruct(blank, recon3d.Settings(n_voxels=3_000))
    assert "\n" not in str(refused.value)


def test_a_pixels_footprint_in_a_room_is_that_on_what_the_cameras_see(room: Scene) -> None:
    assert room.camera_inside
    assert 0.05 / 55 < room.pixel_footprint < 0.2 / 55
    moved = transformed(room, 1e3, np.array([1e6, 0.0, 0.0]))
    assert moved.pixel_footprint == pytest.approx(1e3 * room.pixel_footprint, rel=1e-6)


def test_walls_are_background_but_for_cameras_inside_them(room: Scene, temple: Scene) -> None:
    points = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(np.array([[-0.205, 0, 0], [-0.3, 0, 0]])))
    points.point.normals = o3d.core.Tensor.from_numpy(np.array([[1.0, 0, 0], [1.0, 0, 0]]))
    assert len(_within(points, room).point.positions) == 1
    outside = replace(temple, bounds=room.bounds)
    assert not outside.camera_inside
    assert len(_within(points, outside).point.positions) == 0
