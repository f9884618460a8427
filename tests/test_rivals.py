"""The tests that the paper is compared with, each by its own rule."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from batches import outcome, patches_of, random_batch
from numpy.typing import ArrayLike
from scipy.stats import chi2, f

from recon3d.carving.fine_generalized import FineGeneralizedVoxelColoring
from recon3d.carving.generalized import GeneralizedVoxelColoring
from recon3d.carving.method import JudgingMethod
from recon3d.carving.space_carving import SpaceCarving
from recon3d.carving.voxel_coloring import VoxelColoring
from recon3d.consistency import TESTS
from recon3d.consistency.base import ConsistencyTest, Patches, verdict_of
from recon3d.consistency.caching import ColorCaching
from recon3d.consistency.correlation import Correlation
from recon3d.consistency.deviation import Adaptive, StandardDeviation, Variance
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis, FuzzySingle
from recon3d.consistency.histogram import Histogram
from recon3d.consistency.hysteresis import Hysteresis
from recon3d.consistency.minkowski import Minkowski
from recon3d.consistency.moments import Moments
from recon3d.consistency.quantiles import chi_square_limits, f_limits
from recon3d.consistency.ratio import FTest, LikelihoodRatio, OutlierRejection
from recon3d.consistency.specular import Specular
from recon3d.datasets.synthetic import BuiltInScene
from recon3d.scene.silhouettes import without_silhouettes
from recon3d.volume.dense import CarvingVolume


def pixels_of(voxel: list[ArrayLike]) -> list[np.ndarray]:
    return [np.asarray(view, float).reshape(-1, 3) for view in voxel if len(np.asarray(view))]


def scatter(pixels: np.ndarray) -> float:
    return float(((pixels - pixels.mean(axis=0)) ** 2).sum())


def between(views: list[np.ndarray]) -> float:
    mean = np.vstack(views).mean(axis=0)
    return float(sum(len(view) * ((view.mean(axis=0) - mean) ** 2).sum() for view in views))


def by_hand(test: ConsistencyTest, views: list[np.ndarray]) -> tuple[float, float]:
    """Value and limit of a voxel, from the definitions."""
    everything = np.vstack(views)
    n_views, n_pixels = len(views), len(everything)
    if isinstance(test, Variance):
        degrees = 3 * (n_pixels - 1)
        return scatter(everything), test.sigma0**2 * chi2.ppf(1 - test.p, degrees) if degrees else 0.0
    if isinstance(test, LikelihoodRatio):
        degrees = 3 * (n_views - 1)
        return between(views), test.sigma0**2 * chi2.ppf(1 - test.p, degrees) if degrees else 0.0
    if isinstance(test, Adaptive):
        inside = np.mean([np.sqrt(view.var(axis=0).mean()) for view in views])
        return float(np.sqrt(everything.var(axis=0).mean())), test.base + test.texture * float(inside)
    assert isinstance(test, FTest)
    degrees = (3 * (n_views - 1), 3 * (n_pixels - n_views))
    if not degrees[0]:
        return 0.0, 0.0
    inside = sum(scatter(view) for view in views) / degrees[1] if degrees[1] else 0.0
    limit = f.ppf(1 - test.p, *degrees) if degrees[1] else chi2.ppf(1 - test.p, degrees[0]) / degrees[0]
    return between(views) / degrees[0] / max(inside, test.floor**2), float(limit)


@pytest.mark.parametrize("test", [Variance(20.0), LikelihoodRatio(30.0, p=0.2), Adaptive(), FTest(floor=3.0, p=0.01)])
def test_a_statistic_and_its_limit_are_those_of_the_definition(test: ConsistencyTest) -> None:
    batch = [*random_batch(3), [[[1, 2, 3]], [[40, 2, 3]], [], []], [[[9, 9, 9]], [], [], []]]
    degree = test(patches_of(batch)).degree
    for voxel, got in zip(batch, degree, strict=True):
        value, limit = by_hand(test, pixels_of(voxel))
        # Two ways of summing; the quantile by sf and by cdf.
        assert got == pytest.approx(limit / (limit + value) if value > 0 else 1, abs=1e-9)
    assert len(set(outcome(test(patches_of(batch))))) == 2


@pytest.mark.parametrize("p", [0.001, 0.05, 0.5])
def test_limits_are_scipys_quantiles(p: float) -> None:
    degrees = np.array([3, 0, 21, 3, 900])
    np.testing.assert_allclose(chi_square_limits(p, degrees), [chi2.isf(p, d) if d else 0 for d in degrees])
    within = np.array([3, 5, 0, 60, 1])
    expected = [f.isf(p, 3, 3), 0, chi2.isf(p, 21) / 21, f.isf(p, 3, 60), f.isf(p, 900, 1)]
    np.testing.assert_allclose(f_limits(p, degrees, within), expected)


def gaussian_patches(n_voxels: int, n_views: int, pixels: int, sigma: float, seed: int = 0) -> Patches:
    rng = np.random.default_rng(seed)
    colors = np.clip(128 + sigma * rng.standard_normal((n_voxels * n_views * pixels, 3)), 0, 255).round()
    starts = np.arange(n_voxels)[:, None] * n_views * pixels + np.arange(n_views + 1) * pixels
    return Patches(colors.astype(np.uint8), starts)


@pytest.mark.parametrize("p", [0.01, 0.05, 0.2])
@pytest.mark.parametrize(
    "kind", [lambda p: Variance(10.0, p), lambda p: LikelihoodRatio(10.0, p), lambda p: FTest(p, 1.0)]
)
@pytest.mark.parametrize(("n_views", "pixels"), [(2, 4), (6, 9)])
def test_true_surface_is_refused_as_often_as_promised(
    kind: Callable[[float], ConsistencyTest], p: float, n_views: int, pixels: int
) -> None:
    n_voxels = 20_000
    refused = np.mean(outcome(kind(p)(gaussian_patches(n_voxels, n_views, pixels, 10.0))) == -1)
    # Four standard deviations of a binomial share, and 5% of p for the rounding to whole grey levels: its variance of
    # 1/12 raises sigma^2 = 100 by 0.08%.
    assert refused == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / n_voxels) + 0.05 * p)


def test_outliers_up_to_a_minority_are_forgiven() -> None:
    good, bad = np.full((9, 3), 200), np.full((9, 3), 20)
    test = OutlierRejection()
    for n_bad in range(6):
        # Of five views there is always a majority.
        assert outcome(test(patches_of([[good] * (5 - n_bad) + [bad] * n_bad]))).tolist() == [1]
    assert outcome(test(patches_of([[good] * 2 + [bad] * 2]))).tolist() == [-1]
    assert outcome(OutlierRejection(quorum=0.8)(patches_of([[good] * 4 + [bad]]))).tolist() == [-1]


def test_the_views_left_are_those_near_the_median() -> None:
    batch = random_batch(7)
    batch += [[np.asarray(views[0]) // 3, *views[1:]] for views in batch]  # with a darker view each
    test = OutlierRejection(sigma0=5.0)
    inliers = test.inliers(Moments.of(patches_of(batch)))
    for voxel, kept in zip(batch, inliers, strict=True):
        means = np.array([view.mean(axis=0) for view in pixels_of(voxel)])
        away = np.linalg.norm(means - np.median(means, axis=0), axis=1)
        noise = 5.0 / np.sqrt([len(view) for view in pixels_of(voxel)])
        assert kept.tolist() == (away <= 2.5 * np.maximum(1.4826 * np.median(away), noise)).tolist()
    assert 5 < np.count_nonzero(~inliers[:, 0]) < len(batch)


def test_a_highlight_on_a_coloured_object_is_accepted_by_the_specular_test_alone() -> None:
    diffuse, white = np.array([150, 30, 40]), np.array([255, 255, 255])
    voxel = [[np.tile(np.round(diffuse + share * (white - diffuse)), (9, 1)) for share in (0, 0, 0.3, 0.8)]]
    assert outcome(Specular(5.0)(patches_of(voxel))).tolist() == [1]
    assert outcome(Minkowski()(patches_of(voxel))).tolist() == [-1]
    # Under a green light the same colours are no highlight.
    assert outcome(Specular(5.0, light=(0, 255, 0))(patches_of(voxel))).tolist() == [-1]


def test_colours_that_change_little_by_little_pass_the_second_test_of_colour_caching() -> None:
    values = (40, 52, 64, 76, 88)
    patches = patches_of([[np.full((4, 3), value) for value in values]])
    angle = np.radians([0, 20, 40, 60, 80])
    arc = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)[None].astype(np.float32)
    shuffled = arc[:, [2, 0, 4, 1, 3]]
    step = 12 * np.sqrt(3)
    for directions, expected in ((arc, 1), (shuffled, -1)):
        patches = Patches(patches.colors, patches.view_starts, directions)
        assert outcome(ColorCaching(30.0, step + 0.01)(patches)).tolist() == [expected]
        assert outcome(ColorCaching(4 * step + 0.01, 0.0)(patches)).tolist() == [1]


def test_correlation_is_the_mean_of_numpys_over_all_pairs() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(0, 255, 25)
    windows = np.array([0.4 * base + 50 * noise * rng.standard_normal((5, 25)) for noise in (0.2, 1, 3)])
    windows[0, 2] = windows[1, 4] = np.nan
    windows[2, :2] = 77.0
    patches = patches_of([[[[1, 1, 1]]] * 5] * 3)
    degree = Correlation()(Patches(patches.colors, patches.view_starts, windows=windows.astype(np.float32))).degree
    for n in range(3):
        pairs = [(a, b) for a in range(5) for b in range(a) if not np.isnan(windows[n, [a, b]]).any()]
        # Flat against flat is 1, flat against texture 0.
        ncc = [
            float(np.corrcoef(windows[n, a], windows[n, b])[0, 1]) if windows[n, [a, b]].std(axis=-1).all()
            else float(windows[n, a].std() == windows[n, b].std())
            for a, b in pairs
        ]  # fmt: skip
        assert degree[n] == pytest.approx((1 + np.mean(ncc)) / 2, abs=1e-6)  # windows are float32


@pytest.mark.parametrize("test", [ColorCaching(), Correlation()])
def test_patches_without_what_a_test_asks_for_are_refused(test: ConsistencyTest) -> None:
    patches = patches_of([[[[1, 2, 3]], [[1, 2, 3]]]])
    with pytest.raises(ValueError, match="expected patches with"):
        test(Patches(patches.colors, patches.view_starts))


def test_one_fixed_threshold_on_the_membership_cuts_where_it_says() -> None:
    voxel = [[np.array([[65] * 3, [100] * 3])]]
    assert FuzzySingle()(patches_of(voxel)).degree[0] == FuzzyAdaptiveHysteresis()(patches_of(voxel)).degree[0] == 0.65
    assert outcome(FuzzySingle(threshold=0.65)(patches_of(voxel))).tolist() == [1]
    assert outcome(FuzzySingle(threshold=0.66)(patches_of(voxel))).tolist() == [-1]


def test_verdict_of_is_half_at_the_limit() -> None:
    verdict = verdict_of(np.array([0.0, 3.0, 3.1, np.inf, 0.0, 2.0]), np.array([3.0, 3.0, 3.0, 3.0, 0.0, 0.0]))
    assert verdict.degree.tolist() == [1.0, 0.5, pytest.approx(3 / 6.1), 0.0, 1.0, 0.0]
    assert outcome(verdict).tolist() == [1, 1, -1, -1, 1, -1]


@pytest.mark.parametrize("name", TESTS)
@pytest.mark.parametrize("margin", [0.0, 0.1, 1.0])
def test_hysteresis_keeps_the_degree_and_moves_the_thresholds(name: str, margin: float) -> None:
    test, patches = TESTS[name](), patches_of(random_batch())
    plain, wide = test(patches), Hysteresis(test, margin)(patches)
    np.testing.assert_array_equal(wide.degree, plain.degree)
    middle = (plain.low + plain.high) / 2
    np.testing.assert_allclose(wide.low, np.maximum(middle - margin, 0))
    np.testing.assert_allclose(wide.high, np.minimum(middle + margin, 1))


def test_hysteresis_without_a_margin_keeps_both_thresholds() -> None:
    patches = patches_of(random_batch())
    plain, same = FuzzyAdaptiveHysteresis()(patches), Hysteresis(FuzzyAdaptiveHysteresis(), None)(patches)
    for name in ("degree", "low", "high"):
        np.testing.assert_array_equal(getattr(same, name), getattr(plain, name))


def test_hysteresis_asks_for_what_its_test_asks_for() -> None:
    assert Hysteresis(ColorCaching()).needs_directions
    assert Hysteresis(Correlation(window_side=7)).window_side == 7
    assert not Hysteresis(StandardDeviation()).needs_directions
    assert Hysteresis(StandardDeviation()).window_side == 0


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (FuzzySingle, {"threshold": 1.1}), (FuzzySingle, {"trim": 0.5}), (Variance, {"p": 0}),
        (Variance, {"sigma0": 0}),
        (Adaptive, {"base": -1}), (Adaptive, {"texture": float("nan")}), (Histogram, {"bins": 0}),
        (Histogram, {"bins": 2.5}), (Histogram, {"bins": 33}), (Histogram, {"overlap": 1.0}),
        (ColorCaching, {"threshold": -1}), (ColorCaching, {"neighbour_threshold": -1}), (Minkowski, {"norm": "l3"}),
        (Minkowski, {"threshold": -1}), (LikelihoodRatio, {"sigma0": -2}), (LikelihoodRatio, {"p": 1}),
        (FTest, {"p": 2}), (FTest, {"floor": 0}), (OutlierRejection, {"quorum": 1}), (OutlierRejection, {"sigma0": 0}),
        (Specular, {"threshold": -1}), (Specular, {"light": (1, 2)}), (Specular, {"light": (0, 0, 256)}),
        (Correlation, {"threshold": 2}), (Correlation, {"window_side": 2}), (Correlation, {"min_deviation": 0}),
        (Hysteresis, {"test": None}), (Hysteresis, {"test": StandardDeviation(), "margin": -0.1}),
    ],
)  # fmt: skip
def test_senseless_options_are_refused(kind: Callable[..., ConsistencyTest], options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        kind(**options)


@pytest.mark.parametrize("method", [VoxelColoring, GeneralizedVoxelColoring])
@pytest.mark.parametrize("name", TESTS)
def test_every_test_carves_some_of_the_temple_and_keeps_some(
    name: str, method: type[JudgingMethod], temple: BuiltInScene
) -> None:
    # Silhouettes would leave some defaults, made for larger photographs, little to carve.
    scene = without_silhouettes(temple.scene)
    if method.one_sided:
        scene = scene.subset([view.name for view in scene.views[:3]])
    volume = CarvingVolume.enclosing(scene.bounds, n_voxels=20_000)
    counts = method(TESTS[name]()).carve(scene, volume).counts()
    assert counts["inconsistent"] > 500
    assert counts["consistent"] > 500


@pytest.mark.parametrize("test", [ColorCaching(), Correlation()])
def test_bricks_hand_a_test_the_same_directions_and_windows(test: ConsistencyTest, temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=20_000)
    dense = GeneralizedVoxelColoring(test).carve(temple.scene, volume)
    sparse = FineGeneralizedVoxelColoring(test).carve(temple.scene, volume).dense()
    np.testing.assert_array_equal(sparse.with_interior.occupied, dense.with_interior.occupied)


def test_space_carving_fills_what_a_test_asks_for(temple: BuiltInScene) -> None:
    volume = CarvingVolume.enclosing(temple.scene.bounds, n_voxels=4000)
    hull = SpaceCarving(Hysteresis(Correlation(0.0)), max_rounds=3).carve(temple.scene, volume)
    assert hull.volume.n_occupied > 50
