from __future__ import annotations

import numpy as np
import open3d as o3d
import pytest
from numpy.typing import NDArray
from scenes import ball_mesh, box_mesh, cameras, edge_counts, plain, signed_volume

from recon3d.carving.visibility import largest_admissible_views
from recon3d.datasets.synthetic import (
    SCENES,
    BuiltInScene,
    little_temple,
    photograph,
    ring,
    temple_mesh,
    temple_texture,
)
from recon3d.rendering.renderer import Renderer, pixel_rays


def white(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """An albedo of one."""
    return np.ones_like(points)


def test_the_ground_truth_is_closed_and_edge_manifold_and_faces_outwards() -> None:
    mesh = temple_mesh()
    assert (edge_counts(mesh) == 2).all()
    assert mesh.is_edge_manifold(allow_boundary_edges=False)
    assert signed_volume(mesh) > 0


def test_the_temple_stands_on_the_ground_and_is_as_tall_as_it_says() -> None:
    mesh = temple_mesh()
    assert mesh.get_min_bound()[2] == pytest.approx(0.0, abs=1e-9)
    # 13 cm, to the centimetre.
    assert mesh.get_max_bound()[2] == pytest.approx(0.13, abs=0.01)
    clusters, _, _ = mesh.cluster_connected_triangles()
    assert len(set(np.asarray(clusters).tolist())) == 1


def test_every_built_in_scene_is_made_by_its_name() -> None:
    for make in SCENES.values():
        built = make(n_views=2, width=32, height=24)
        assert isinstance(built, BuiltInScene)
        assert len(built.scene.views) == 2


def test_the_scene_holds_the_surface_it_was_photographed_from(temple: BuiltInScene) -> None:
    assert (temple.scene.bounds.low <= temple.ground_truth.get_min_bound()).all()
    assert (temple.scene.bounds.high >= temple.ground_truth.get_max_bound()).all()
    assert len(temple.scene.views) == 8
    vertices = np.asarray(temple.ground_truth.vertices)
    for view in temple.scene.views:
        assert (view.height, view.width) == (120, 160)
        assert view.sees(vertices).all()
        assert view.K[0, 1] != 0
        assert view.K[0, 0] != view.K[1, 1]


def test_the_cameras_look_down_so_that_many_can_be_used_together(temple: BuiltInScene) -> None:
    assert len(largest_admissible_views(temple.scene)) >= 4


def test_silhouettes_are_exactly_the_pixels_where_some_ray_hits(temple: BuiltInScene) -> None:
    view = temple.scene.views[3]
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(temple.ground_truth))
    expected = np.zeros((view.height, view.width), np.bool_)
    # Two rays a pixel in each direction: offsets of a quarter pixel from its centre.
    for du in (-0.25, 0.25):
        for dv in (-0.25, 0.25):
            K = view.K.copy()
            K[:2, 2] -= (du, dv)
            center, directions = pixel_rays(K, view.cam_from_world, view.width, view.height)
            rays = np.concatenate([np.broadcast_to(center, directions.shape), directions], axis=2)
            answer = scene.cast_rays(o3d.core.Tensor.from_numpy(rays.astype(np.float32)))
            expected |= np.isfinite(answer["t_hit"].numpy())
    # Rays that graze an edge may fall on either side in single precision.
    assert (view.silhouette != expected).sum() <= 2
    assert expected.sum() > 1000


def test_beside_the_silhouette_the_photograph_is_black_and_on_it_never(temple: BuiltInScene) -> None:
    for view in temple.scene.views:
        assert view.silhouette is not None
        assert not view.image[~view.silhouette].any()
        assert view.image[view.silhouette].any(axis=1).all()


def test_one_ray_a_pixel_gives_the_renderers_own_picture() -> None:
    eyes = cameras(2)
    for view in photograph(ball_mesh(), plain, eyes, supersampling=1).views:
        np.testing.assert_array_equal(view.silhouette, Renderer(ball_mesh()).render_view(view).hit)


def test_supersampling_softens_the_rim_and_leaves_the_inside() -> None:
    eyes = cameras(1)
    mesh = box_mesh(1.3, 1.1, 1.2)
    hard, soft = (photograph(mesh, plain, eyes, supersampling=s).views[0] for s in (1, 4))
    hard_levels, soft_levels = (len(np.unique(view.image[..., 0])) for view in (hard, soft))
    # A box of one albedo shows at most three shades and black; rims and edges in between come from averaging.
    assert hard_levels <= 4
    assert soft_levels > hard_levels
    same = (hard.image == soft.image).all(axis=2)
    assert same.mean() > 0.8
    assert hard.silhouette is not None
    assert soft.silhouette is not None
    assert hard.silhouette.sum() < soft.silhouette.sum()


def test_the_anti_aliased_rim_covers_the_same_area() -> None:
    (eye,) = cameras(1, width=160, height=120)
    hard, soft = (
        float(photograph(box_mesh(1.3, 1.1, 1.2), white, [eye], supersampling=s).views[0].image.sum(dtype=np.int64))
        for s in (1, 4)
    )
    # A rim of half a pixel, all of it on one side, would be 2% of an area of 50 x 50 pixels on each of four sides.
    assert hard == pytest.approx(soft, rel=0.02)


def test_edges_shade_sharply() -> None:
    view = photograph(box_mesh(1.3, 1.1, 1.2), white, cameras(1), supersampling=1).views[0]
    assert view.silhouette is not None
    # Three faces in sight at most, each of one shade.
    assert len(np.unique(view.image[view.silhouette], axis=0)) <= 3


def test_noise_has_the_strength_that_was_asked_for_and_depends_on_the_seed() -> None:
    clean, noisy, again, other = (
        little_temple(n_views=2, width=64, height=48, noise=noise, seed=seed).scene
        for noise, seed in ((0.0, 0), (5.0, 0), (5.0, 0), (5.0, 1))
    )
    difference = []
    for a, b, c, d in zip(clean.views, noisy.views, again.views, other.views, strict=True):
        np.testing.assert_array_equal(b.image, c.image)
        assert (b.image != d.image).any()
        np.testing.assert_array_equal(a.silhouette, b.silhouette)
        middle = (a.image > 40) & (a.image < 215)  # where nothing is clipped
        difference.append((b.image.astype(float) - a.image)[middle])
    # Rounding adds 1/12 to a variance of 25; the standard error over some thousand samples is 2%.
    assert np.concatenate(difference).std() == pytest.approx(np.sqrt(25 + 1 / 12), rel=0.1)


def test_a_change_of_light_scales_whole_views() -> None:
    clean, changed = (
        little_temple(n_views=6, width=64, height=48, light_change=change, seed=3).scene for change in (0.0, 0.15)
    )
    gains = []
    for a, b in zip(clean.views, changed.views, strict=True):
        usable = (a.image > 60) & (b.image < 255)
        gain = np.median(b.image[usable] / a.image[usable])
        gains.append(gain)
        # One gain for the view, but for rounding of two grey levels' halves.
        np.testing.assert_allclose(b.image[usable], gain * a.image[usable], atol=2)
    assert 0.05 < np.std(gains) < 0.4
    assert len(set(np.round(gains, 3))) == 6


@pytest.mark.parametrize(
    "options",
    [{"n_views": 0}, {"width": 7}, {"height": 7}, {"supersampling": 0}, {"noise": -1.0}, {"light_change": -0.1}],
)
def test_senseless_options_are_refused(options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"expected (n_views >= 1|0 <= noise)"):
        little_temple(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("arc", "last"), [(360.0, 270.0), (90.0, 90.0)])
def test_a_ring_of_cameras_stands_around_its_centre(arc: float, last: float) -> None:
    center = np.array([0.5, -0.3, 0.2])
    eyes = ring(center, n_views=4, distance=2.0, width=40, height=30, focal=50.0, elevation=30.0, arc=arc)
    places = np.array([-camera.cam_from_world[:3, :3].T @ camera.cam_from_world[:3, 3] for camera in eyes]) - center
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 2.0)
    np.testing.assert_allclose(places[:, 2], 1.0)  # two times the sine of 30 degrees
    angles = np.degrees(np.arctan2(places[:, 1], places[:, 0])) % 360
    np.testing.assert_allclose(angles, np.linspace(0, last, 4), atol=1e-9)
    for camera in eyes:
        # The centre lies on the optical axis.
        np.testing.assert_allclose((camera.cam_from_world @ [*center, 1])[:2], 0, atol=1e-12)


def test_a_ring_of_one_camera_stands_at_its_beginning() -> None:
    for arc in (360.0, 90.0):
        (camera,) = ring(np.zeros(3), n_views=1, distance=2.0, width=40, height=30, focal=50.0, elevation=0.0, arc=arc)
        np.testing.assert_allclose(
            -camera.cam_from_world[:3, :3].T @ camera.cam_from_world[:3, 3], [2, 0, 0], atol=1e-12
        )


def test_the_texture_is_an_albedo_with_detail_in_it() -> None:
    points = np.random.default_rng(0).uniform([-0.05, -0.04, 0], [0.05, 0.04, 0.13], (4000, 3))
    albedo = temple_texture(points)
    assert albedo.shape == (4000, 3)
    assert albedo.min() > 0
    assert albedo.max() <= 1
    assert (albedo.std(axis=0) > 0.05).all()
    np.testing.assert_array_equal(albedo, temple_texture(points))
    # The roof is redder than the stone below it.
    redness = albedo[:, 0] / albedo[:, 2]
    roof = points[:, 2] > 0.0921
    assert redness[roof].mean() > 1.3 * redness[~roof].mean()
