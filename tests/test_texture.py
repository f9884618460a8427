"""Textures, against worlds whose colour is known everywhere, and as other programs read them."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import open3d as o3d
import pytest
import trimesh
from numpy.typing import NDArray
from scenes import ball_mesh, cameras, photographs, stripes, two_planes_mesh

from recon3d.datasets.synthetic import _irradiance
from recon3d.errors import ArgumentError, EmptyReconstructionError
from recon3d.io.textured import write_textured
from recon3d.kernels.texels import draw_triangles, grow_charts
from recon3d.rendering.orbit import upright
from recon3d.rendering.ray_caster import RayCaster
from recon3d.rendering.renderer import Renderer
from recon3d.rendering.texture import Texture
from recon3d.scene.scene import Scene
from recon3d.scratch import Scratch
from recon3d.surface.atlas import unwrap
from recon3d.surface.exposure import view_gains
from recon3d.surface.texture import TexturedMesh, _padded, texture_mesh
from recon3d.surface.trust import trusted_pixels


def ball_scene(n_views: int = 8) -> tuple[o3d.geometry.TriangleMesh, Scene]:
    mesh = ball_mesh(1.0, 60)
    mesh.compute_vertex_normals()
    return mesh, photographs(mesh, taken_by=cameras(n_views, arc=360, width=160, height=120), supersampling=2)


@pytest.fixture(scope="module")
def ball() -> tuple[Scene, TexturedMesh]:
    mesh, scene = ball_scene()
    return scene, texture_mesh(mesh, scene, size=512, triangles=4000)


def found_gains(mesh: o3d.geometry.TriangleMesh, scene: Scene) -> NDArray[np.float64]:
    caster, scratch = RayCaster(mesh), Scratch()
    return view_gains(mesh, scene, caster, [scratch.keep(trusted_pixels(caster, view)) for view in scene.views])


def at_middles(textured: TexturedMesh) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles of the triangles (n, 3), and their colours (n, 3), 0 to 255."""
    triangles = np.asarray(textured.mesh.triangles)
    weights = np.full((len(triangles), 3), 1 / 3)
    colors = 255 * textured.texture.colors(np.arange(len(triangles)), weights)
    return np.asarray(textured.mesh.vertices)[triangles].mean(axis=1), colors


def test_a_balls_texture_is_exact_to_a_few_grey_levels(ball: tuple[Scene, TexturedMesh]) -> None:
    scene, textured = ball
    points, colors = at_middles(textured)
    outwards = points / np.linalg.norm(points, axis=1, keepdims=True)
    exact = 255 * stripes(outwards) * _irradiance(outwards)[:, None]
    sights = scene.centers[:, None] - points
    best = (sights * outwards).sum(axis=2) / np.linalg.norm(sights, axis=2)
    facing = best.max(axis=0) > 0.4
    assert facing.mean() > 0.5
    error = np.abs(colors - exact)[facing].mean(axis=1)
    # As for vertices, and facets of 4000 triangles whose normals are off by two degrees.
    assert error.mean() < 0.7
    assert error.max() < 6
    assert textured.decimation is not None
    assert len(textured.mesh.triangles) <= 4000
    # The ring of cameras, 17 degrees up, does not see what lies below.
    assert 0.6 < textured.seen_share < 0.95
    assert textured.texel == pytest.approx(np.sqrt(4 * np.pi / 0.6) / 512, rel=0.2)


def test_a_left_out_view_is_rendered_from_the_texture(ball: tuple[Scene, TexturedMesh]) -> None:
    _, textured = ball
    (view,) = photographs(ball_mesh(1.0, 60), taken_by=cameras(7, arc=300, width=160, height=120)[3:4]).views
    seen = Renderer(textured.mesh, texture=textured.texture).render_view(view)
    inner = cv2.erode((seen.hit & view.may_show_object).astype(np.uint8), np.ones((5, 5))) > 0
    assert inner.sum() > 2000
    difference = np.abs(255 * seen.colors - view.image)[inner]
    assert difference.mean() < 1.5
    assert (seen.colors[~seen.hit] == 0).all()


def test_what_lies_before_does_not_bleed_onto_what_lies_behind() -> None:
    mesh = two_planes_mesh().subdivide_midpoint(3)
    mesh.compute_vertex_normals()

    def red_above_blue(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(points[:, 2:] > 0, [[0.9, 0.0, 0.0]], [[0.0, 0.0, 0.9]])

    scene = photographs(mesh, red_above_blue, cameras(8, arc=360, width=96, height=72), supersampling=3)
    textured = texture_mesh(mesh, scene, size=256, triangles=len(mesh.triangles))
    assert textured.decimation is None
    points, colors = at_middles(textured)
    above = points[:, 2] > 0
    foreign = np.where(above, colors[:, 2], colors[:, 0])
    own = np.where(above, colors[:, 0], colors[:, 2])
    # The texels of a pixel's size have seams where charts meet.
    assert np.quantile(foreign, 0.99) < 5
    assert (own > 20).mean() > 0.9


@pytest.mark.parametrize("noise", [0, 6])
def test_exposure_and_white_balance_are_evened(noise: int) -> None:
    mesh, scene = ball_scene()
    rng = np.random.default_rng(1)
    factors = rng.uniform(0.85, 1.1, (len(scene.views), 3))
    changed = tuple(
        replace(
            view,
            photograph=np.clip(view.image * factor + noise * rng.standard_normal(view.image.shape), 0, 255).astype(
                np.uint8
            ),
        )
        for view, factor in zip(scene.views, factors, strict=True)
    )
    gains = found_gains(mesh, replace(scene, views=changed))
    evened = gains * factors
    np.testing.assert_allclose(evened / evened.mean(axis=0), 1, atol=0.01 if noise else 0.006)
    np.testing.assert_allclose(np.exp(np.log(gains).mean(axis=0)), 1, atol=1e-9)


def test_a_view_that_shares_nothing_keeps_its_exposure() -> None:
    mesh, scene = ball_scene(4)
    alone = replace(scene, views=(scene.views[0], scene.views[2]))  # on opposite sides
    np.testing.assert_allclose(found_gains(mesh, alone), 1, atol=0.05)
    np.testing.assert_allclose(found_gains(mesh, replace(scene, views=scene.views[:1])), 1)


def test_a_large_texel_shows_the_mean_of_what_it_covers() -> None:
    mesh, scene = ball_scene(4)
    checkered = tuple(
        replace(view, photograph=np.repeat(255 * (np.indices(view.image.shape[:2]).sum(axis=0) % 2)[..., None], 3, 2)
                .astype(np.uint8))
        for view in scene.views
    )  # fmt: skip
    textured = texture_mesh(mesh, replace(scene, views=checkered), size=32, triangles=500)
    assert textured.texel > 3 * scene.pixel_footprint
    _, colors = at_middles(textured)
    assert np.abs(colors - 127.5).mean() < 25


def test_a_surface_that_no_view_shows_has_no_texture() -> None:
    mesh, scene = ball_scene(2)
    with pytest.raises(EmptyReconstructionError, match="no view shows any of the surface"):
        texture_mesh(mesh.translate((0, 0, 50.0)), scene, size=64, triangles=500)


def test_bad_sizes_are_refused() -> None:
    mesh, scene = ball_scene(2)
    with pytest.raises(ArgumentError, match="expected size to be a whole number from 16 to 8192, got 0"):
        texture_mesh(mesh, scene, size=0)
    with pytest.raises(ArgumentError, match="expected triangles"):
        texture_mesh(mesh, scene, triangles=1)


def test_every_triangle_has_a_place_of_its_own() -> None:
    size = 128
    places = unwrap(ball_mesh(1.0, 16).translate((1e5, -1e5, 0)), size) * size - 0.5
    owner = np.full((size, size), -1, np.int32)
    draw_triangles(places, owner)
    corners, rows = places[:, None], np.indices((size, size)).reshape(2, -1).T[:, ::-1][None]
    edges = np.roll(corners, -1, axis=2) - corners
    off = rows[:, :, None] - corners
    sides = edges[..., 0] * off[..., 1] - edges[..., 1] * off[..., 0]
    area = sides.sum(axis=2)
    inside = (sides * np.sign(area)[..., None] > 1e-9).all(axis=2)
    assert inside.sum(axis=0).max() == 1  # no two triangles overlap
    drawn = owner.ravel()
    single = inside.any(axis=0)
    np.testing.assert_array_equal(drawn[single], inside.argmax(axis=0)[single])
    assert (drawn[~(sides * np.sign(area)[..., None] >= -1e-9).all(axis=2).any(axis=0)] == -1).all()
    assert 0.3 < single.mean() < 0.9
    grown = owner.copy()
    grow_charts(owner, grown)
    ring = cv2.dilate((owner >= 0).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
    np.testing.assert_array_equal(grown >= 0, ring)
    np.testing.assert_array_equal(grown[owner >= 0], owner[owner >= 0])


def test_what_has_no_colour_continues_what_is_around_it() -> None:
    colors = np.full((13, 20, 3), np.nan, np.float32)
    colors[:, :6] = [10, 20, 30]
    colors[:, -3:] = [110, 120, 130]
    filled = _padded(colors)
    np.testing.assert_array_equal(filled[:, :6], np.broadcast_to([10, 20, 30], (13, 6, 3)))
    np.testing.assert_array_equal(filled[:, -3:], np.broadcast_to([110, 120, 130], (13, 3, 3)))
    assert filled[..., 0].min() == 10
    assert filled[..., 0].max() == 110
    assert (np.abs(filled[:, 7, 0].astype(int) - 10) < 50).all()
    assert (filled[:, 15, 0] > filled[:, 8, 0]).all()


def test_a_texture_is_looked_up_between_its_texels() -> None:
    image = np.zeros((2, 4, 3), np.uint8)
    image[0, :, 0] = [0, 40, 80, 120]
    image[1] = 200
    texture = Texture(np.array([[[0.125, 0.25], [0.875, 0.25], [0.125, 0.75]]]), image)
    weights = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0]], float)
    found = 255 * texture.colors(np.zeros(4, int), weights)
    np.testing.assert_allclose(found[:, 0], [0, 120, 200, 60], atol=1)
    with pytest.raises(ArgumentError, match=r"expected places \(n_triangles, 3, 2\)"):
        Texture(np.zeros((3, 2)), image)
    with pytest.raises(ArgumentError, match="uint8 image"):
        Texture(np.zeros((1, 3, 2)), image / 255)  # type: ignore[arg-type]


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_other_programs_read_metres_y_up_and_the_picture(
    ball: tuple[Scene, TexturedMesh], tmp_path: Path, suffix: str
) -> None:
    scene, textured = ball
    frame = upright(replace(scene, mm_per_unit=10.0), up="y", unit_mm=1000.0)
    small = replace(textured, file_from_world=frame)
    written = small.write(tmp_path / f"ball{suffix}")
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in written}
    loaded = trimesh.load(written[0], force="mesh", process=False)
    assert loaded.area == pytest.approx(textured.mesh.get_surface_area() * 1e-4, rel=1e-4)
    assert loaded.volume > 0  # the right side is out
    assert len(loaded.faces) == len(textured.mesh.triangles)
    corners = np.asarray(loaded.vertices)[loaded.faces]
    world = np.asarray(textured.mesh.vertices)[np.asarray(textured.mesh.triangles)]
    np.testing.assert_allclose(corners, 0.01 * world[..., [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    material = loaded.visual.material
    picture = material.baseColorTexture if suffix == ".glb" else material.image
    np.testing.assert_array_equal(np.asarray(picture.convert("RGB")), textured.texture.image)
    # trimesh's v runs upwards.
    uv = np.asarray(loaded.visual.uv)[loaded.faces]
    np.testing.assert_allclose(uv * [1, -1] + [0, 1], textured.texture.places, atol=1e-6)


def test_a_glb_keeps_to_its_format(ball: tuple[Scene, TexturedMesh], tmp_path: Path) -> None:
    (path,) = ball[1].write(tmp_path / "ball.glb")
    content = path.read_bytes()
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack("<I4s", content[12:20])
    assert (size % 4, kind) == (0, b"JSON")
    document = json.loads(content[20 : 20 + size])
    (buffer,) = document["buffers"]
    assert struct.unpack("<I4s", content[20 + size : 28 + size]) == (buffer["byteLength"], b"BIN\0")
    assert len(content) == 28 + size + buffer["byteLength"]
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    places = np.frombuffer(content, "<f4", 3 * document["accessors"][0]["count"], 28 + size).reshape(-1, 3)
    np.testing.assert_array_equal(places.min(axis=0), np.float32(document["accessors"][0]["min"]))


def test_textures_have_formats_of_their_own(ball: tuple[Scene, TexturedMesh], tmp_path: Path) -> None:
    textured = ball[1]
    with pytest.raises(ArgumentError, match=r"a\.ply: a textured mesh is written as \.glb, \.obj"):
        write_textured(tmp_path / "a.ply", textured.mesh, textured.texture.places, textured.texture.image)
