from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from batches import WINDOW_SIDE, outcome, patches_of, random_batch, window_of
from numpy.typing import ArrayLike

from recon3d.consistency import TESTS
from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.consistency.deviation import StandardDeviation
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis, alternating_harmonic


def clashing_voxel() -> list[np.ndarray]:
    """A red, a green and a blue view, each with a little texture."""
    rng = np.random.default_rng(5)
    return [np.clip(np.roll([200, 20, 20], n) + rng.integers(-9, 10, (12, 3)), 0, 255) for n in range(3)]


def assert_same(a: Verdict, b: Verdict) -> None:
    # Sums in another order round differently; nothing else may change.
    np.testing.assert_allclose(a.degree, b.degree, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.low, b.low, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.high, b.high, rtol=0, atol=1e-12)


@pytest.fixture(params=TESTS)
def test(request: pytest.FixtureRequest) -> ConsistencyTest:
    """Every photo-consistency test by name, with its defaults."""
    return TESTS[request.param]()


def test_every_test_has_the_protocol(test: ConsistencyTest) -> None:
    assert isinstance(test, ConsistencyTest)


@pytest.mark.parametrize("n_views", [1, 2, 9])
def test_identical_pixels_are_consistent(test: ConsistencyTest, n_views: int) -> None:
    colors = [[c, 90, 200 - c] for c in (1, 60, 200)]
    verdict = test(patches_of([[[color] * n] * n_views for color in colors for n in (1, 5)]))
    assert (outcome(verdict) == 1).all()


def test_black_pixels_are_consistent(test: ConsistencyTest) -> None:
    verdict = test(patches_of([[np.zeros((4, 3))] * 3, [np.zeros((1, 3)), [], []]]))
    assert outcome(verdict).tolist() == [1, 1]


def test_one_view_with_one_pixel_is_consistent(test: ConsistencyTest) -> None:
    assert outcome(test(patches_of([[[[12, 200, 7]]]]))).tolist() == [1]


# What a test accepts by its nature: greys are mixtures of black and a white light; NCC knows no brightness, so that
# flat windows of any level are alike; one bad view of three or more is an outlier.
FORGIVES_GREY = ("specular", "ncc")
FORGIVES_ONE = ("outlier-rejection",)


@pytest.mark.parametrize("n_views", [2, 3, 4])
@pytest.mark.parametrize("name", [name for name in TESTS if name not in FORGIVES_GREY])
def test_a_grossly_different_view_is_not_consistent(name: str, n_views: int) -> None:
    agreeing = [np.full((6, 3), 210)] * (n_views - 1)
    verdict = TESTS[name]()(patches_of([[*agreeing, np.full((6, 3), 20)]]))
    forgiven = name in FORGIVES_ONE and n_views > 2
    assert outcome(verdict).tolist() == [1 if forgiven else -1]


@pytest.mark.parametrize("name", FORGIVES_GREY)
def test_a_different_brightness_is_forgiven_where_a_test_is_blind_to_it(name: str) -> None:
    assert outcome(TESTS[name]()(patches_of([[np.full((6, 3), 210), np.full((6, 3), 20)]]))).tolist() == [1]


@pytest.mark.parametrize("n_views", [2, 3])
def test_views_of_quite_different_colours_and_patterns_are_not_consistent(test: ConsistencyTest, n_views: int) -> None:
    # Red, green, blue: each far from the others, off any line to white, and none of them an outlier.
    assert outcome(test(patches_of([clashing_voxel()[:n_views]]))).tolist() == [-1]


@pytest.mark.parametrize("name", [name for name in TESTS if name != "outlier-rejection"])
def test_the_degree_falls_as_a_view_departs(name: str) -> None:
    first, second, _ = clashing_voxel()
    shares = np.linspace(0, 1, 6)
    patches = patches_of([[first, (first + share * (second - first)).round()] for share in shares])
    pattern = window_of(first.astype(np.uint8)) - 100
    # From the same pattern to its negative, by way of a flat window and not quite through it.
    windows = np.array([[100 + pattern, 100 + np.cos(np.pi * share) * pattern] for share in shares], np.float32)
    degree = TESTS[name]()(replace(patches, windows=windows)).degree
    # Rounded colours let a degree rise by a little less than it falls in a step.
    assert (np.diff(degree) < 0.02).all()
    assert degree[-1] < degree[0] - 0.2


def test_an_empty_batch_gives_an_empty_verdict(test: ConsistencyTest) -> None:
    bare = Patches(np.empty((0, 3), np.uint8), np.empty((0, 5), np.int64))
    extras = {"directions": np.empty((0, 4, 3), np.float32), "windows": np.empty((0, 4, WINDOW_SIDE**2), np.float32)}
    verdict = test(replace(bare, **extras))
    assert verdict.degree.shape == verdict.low.shape == verdict.high.shape == (0,)
    verdict = test(bare)
    assert verdict.degree.shape == verdict.low.shape == verdict.high.shape == (0,)


def test_the_verdict_is_in_range_and_free_of_nan(test: ConsistencyTest) -> None:
    odd = [[np.zeros((3, 3))] * 4, [np.full((1, 3), 255), [], [], []], [*clashing_voxel(), []]]
    verdict = test(patches_of([*random_batch(), *odd]))
    assert len(verdict.degree) == 39
    assert ((verdict.degree >= 0) & (verdict.degree <= 1)).all()
    assert np.isfinite([verdict.degree, verdict.low, verdict.high]).all()
    assert (verdict.low <= verdict.high).all()
    # The batch is good for something: it holds voxels of every kind that the test knows.
    assert {1, -1} <= set(outcome(verdict).tolist())


def test_the_order_of_the_views_does_not_matter_to_a_test(test: ConsistencyTest) -> None:
    batch = random_batch()
    shuffled = [[views[n] for n in (2, 0, 3, 1)] for views in batch]
    assert_same(test(patches_of(batch)), test(patches_of(shuffled)))


def test_the_order_of_the_pixels_does_not_matter(test: ConsistencyTest) -> None:
    batch = random_batch()
    rng = np.random.default_rng(1)
    shuffled = [[rng.permutation(np.asarray(pixels)) for pixels in views] for views in batch]
    assert_same(test(patches_of(batch)), test(patches_of(shuffled)))


def test_a_voxel_is_judged_the_same_alone_and_in_a_batch(test: ConsistencyTest) -> None:
    batch = random_batch()
    together = test(patches_of(batch))
    for n, voxel in enumerate(batch):
        alone = test(patches_of([voxel]))
        np.testing.assert_allclose(alone.degree[0], together.degree[n], rtol=0, atol=1e-12)
        assert outcome(alone)[0] == outcome(together)[n]


def test_a_view_that_does_not_see_the_voxel_changes_nothing(test: ConsistencyTest) -> None:
    batch = random_batch()
    assert_same(test(patches_of(batch)), test(patches_of([[views[0], [], *views[1:], []] for views in batch])))


def test_the_pixels_are_not_changed(test: ConsistencyTest) -> None:
    patches = patches_of(random_batch())
    before = patches.colors.copy()
    test(patches)
    np.testing.assert_array_equal(patches.colors, before)


def test_patches_know_their_voxels_and_views() -> None:
    patches = patches_of([[[[1, 1, 1]], [], [[2, 2, 2], [3, 3, 3]]], [[], [[4, 4, 4]], []]])
    assert patches.n_voxels == 2
    assert patches.starts.tolist() == [0, 3, 4]
    assert patches.counts.tolist() == [[1, 0, 2], [0, 1, 0]]
    assert patches.n_views.tolist() == [2, 1]
    assert patches.voxel_of_pixel.tolist() == [0, 0, 0, 1]


def test_empty_patches_have_starts() -> None:
    patches = Patches(np.empty((0, 3), np.uint8), np.empty((0, 4), np.int64))
    assert patches.n_voxels == 0
    assert patches.starts.tolist() == [0]
    assert patches.voxel_of_pixel.tolist() == []


@pytest.mark.parametrize(
    ("degree", "low", "high", "message"),
    [
        ([0.5, 0.5], [0.1], [0.1], "of one length"),
        ([[0.5]], [[0.1]], [[0.1]], "of one length"),
        ([1.5], [0.1], [0.2], r"every degree in \[0, 1\]"),
        ([-0.1], [0.1], [0.2], r"every degree in \[0, 1\]"),
        ([np.nan], [0.1], [0.2], "gave NaN"),
        ([0.5], [0.3], [0.2], "low <= high"),
        ([0.5], [np.nan], [0.2], "low <= high"),
    ],
)
def test_a_malformed_verdict_is_refused(degree: ArrayLike, low: ArrayLike, high: ArrayLike, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Verdict(np.asarray(degree, float), np.asarray(low, float), np.asarray(high, float))


@pytest.mark.parametrize(
    ("n", "low", "high"),
    [(1, 0.5, 0.8333), (2, 0.5833, 0.7833), (4, 0.6345, 0.7456), (8, 0.6629, 0.7217), (16, 0.6778, 0.7081)],
)
def test_thresholds_have_the_published_values(n: int, low: float, high: float) -> None:
    # The values are published with four digits.
    np.testing.assert_allclose(alternating_harmonic([2 * n, 2 * n + 1]), [low, high], rtol=0, atol=5e-5)
    verdict = FuzzyAdaptiveHysteresis()(patches_of([[[[9, 9, 9]]] * n]))
    np.testing.assert_allclose([verdict.low[0], verdict.high[0]], [low, high], rtol=0, atol=5e-5)


def test_the_alternating_harmonic_series_tends_to_log_2_from_both_sides() -> None:
    n = np.arange(1, 500)
    even, odd = alternating_harmonic(2 * n), alternating_harmonic(2 * n + 1)
    assert (even < np.log(2)).all()
    assert (odd > np.log(2)).all()
    assert (np.diff(even) > 0).all()
    assert (np.diff(odd) < 0).all()
    # The error of an alternating series is below its next term.
    assert (odd - np.log(2) < 1 / (2 * n + 2)).all()


def test_the_alternating_harmonic_series_keeps_the_shape_it_is_given() -> None:
    assert alternating_harmonic(np.array([[1, 2], [3, 1]])).shape == (2, 2)
    assert alternating_harmonic(1) == 1.0
    assert alternating_harmonic(np.empty(0, np.int64)).shape == (0,)


def test_the_alternating_harmonic_series_begins_at_one() -> None:
    with pytest.raises(ValueError, match="expected n >= 1, got 0"):
        alternating_harmonic([3, 0])


@pytest.mark.parametrize(
    ("n_views", "low", "high", "expected"),
    [
        # Ratios of 8-bit intensities that equal a threshold: S(2) = 1/2, S(3) = 5/6, S(4) = 7/12, S(5) = 47/60,
        # S(6) = 37/60. At T_low a voxel is carved, at T_high it is consistent.
        (1, 60, 120, -1),
        (1, 100, 120, 1),
        (2, 70, 120, -1),
        (2, 141, 180, 1),
        (3, 74, 120, -1),
    ],
)
def test_a_membership_on_a_threshold_is_decided_exactly(n_views: int, low: int, high: int, expected: int) -> None:
    views = [np.full((1, 3), low), *[np.full((1, 3), high)] * max(n_views - 1, 0)]
    if n_views == 1:
        views = [np.array([[low] * 3, [high] * 3])]
    thresholds = {Fraction(1, 2), Fraction(5, 6), Fraction(7, 12), Fraction(47, 60), Fraction(37, 60)}
    assert Fraction(low, high) in thresholds
    assert outcome(FuzzyAdaptiveHysteresis()(patches_of([views]))).tolist() == [expected]


def test_more_views_are_judged_more_strictly() -> None:
    # mu = 0.65 lies above T_low for four views (0.6345) and below it for eight (0.6629).
    few, many = ([[[130] * 3], *[[[200] * 3]] * (n - 1)] for n in (4, 8))
    assert outcome(FuzzyAdaptiveHysteresis()(patches_of([few]))).tolist() == [0]
    assert outcome(FuzzyAdaptiveHysteresis()(patches_of([many]))).tolist() == [-1]


def test_channels_see_a_change_of_hue_that_luminance_does_not() -> None:
    # 0.299 * 200 and 0.587 * 102 are the same luminance, 60.
    voxel = [[[200, 0, 0]], [[0, 102, 0]]]
    assert FuzzyAdaptiveHysteresis()(patches_of([voxel])).degree[0] == 1.0
    assert FuzzyAdaptiveHysteresis(intensity="channels")(patches_of([voxel])).degree[0] == 0.0


def test_trim_leaves_outliers_out() -> None:
    voxel = [[np.array([[100] * 3] * 18 + [[0] * 3, [255] * 3])]]
    assert FuzzyAdaptiveHysteresis(trim=0.1)(patches_of(voxel)).degree[0] == 1.0
    assert FuzzyAdaptiveHysteresis(trim=0.0)(patches_of(voxel)).degree[0] == 0.0


@pytest.mark.parametrize("options", [{"intensity": "hue"}, {"trim": 0.5}, {"trim": -0.1}, {"trim": float("nan")}])
def test_the_fuzzy_test_refuses_senseless_options(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        FuzzyAdaptiveHysteresis(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("threshold", [-1.0, 128.0, float("nan")])
def test_the_standard_deviation_refuses_a_senseless_threshold(threshold: float) -> None:
    with pytest.raises(ValueError, match=r"expected threshold to be a number in \[0, 127\.5\]"):
        StandardDeviation(threshold)


def test_the_standard_deviation_is_that_of_the_three_channels_together() -> None:
    batch = random_batch(2)
    degree = StandardDeviation()(patches_of(batch)).degree
    for voxel, value in zip(batch, degree, strict=True):
        pixels = np.vstack([np.asarray(view, float) for view in voxel])
        # Two ways of summing: rounding alone.
        assert value == pytest.approx(1 - np.sqrt(pixels.var(axis=0).mean()) / 127.5, abs=1e-12)


def test_a_deviation_at_the_threshold_is_consistent() -> None:
    # Values 100 and 120 in every channel deviate by 10.
    voxel = [[[100] * 3], [[120] * 3]]
    assert outcome(StandardDeviation(10.0)(patches_of([voxel]))).tolist() == [1]
    assert outcome(StandardDeviation(9.99)(patches_of([voxel]))).tolist() == [-1]
