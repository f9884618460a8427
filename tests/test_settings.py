"""Every choice of the main job in one value."""

from __future__ import annotations

import copy
import json
import pickle
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import recon3d
from recon3d import Matching, Meshing, Settings
from recon3d.carving import METHODS, Method, SpaceCarving
from recon3d.consistency import Hysteresis, StandardDeviation
from recon3d.datasets import BuiltInScene
from recon3d.errors import ArgumentError, SceneError
from recon3d.io.files import write_json
from recon3d.scene import without_silhouettes
from recon3d.stereo import PASSES

CHOICES = (
    Settings(),
    Settings(views="all", voxel_size=0.01, carving=recon3d.VoteCarving(min_score=0.7), matching=None),
    Settings(
        views=("a*", "b"),
        carving=recon3d.VoxelColoring(Hysteresis(StandardDeviation(20), 0.1)),
    ),
    Settings(max_views=8, n_voxels=2000, carving=recon3d.VoxelColoring(connectivity=6), meshing=Meshing(smoothing=0)),
    Settings(matching=(Matching(stride=4), Matching()), meshing=Meshing("graph-cut", keep_unsupported=False)),
)


@pytest.mark.parametrize("settings", CHOICES)
def test_settings_copy_compare_hash_pickle_merge_and_record_themselves(settings: Settings, tmp_path: Path) -> None:
    for again in (copy.deepcopy(settings), pickle.loads(pickle.dumps(settings)), replace(settings)):  # noqa: S301
        assert again == settings
        assert hash(again) == hash(settings)
    assert len({*CHOICES, settings}) == len(CHOICES)
    changed = replace(settings, meshing=replace(settings.meshing, min_component=3))
    assert changed != settings
    assert changed.carving == settings.carving
    record = json.loads(write_json(tmp_path / "record.json", settings.record()).read_text())
    assert Settings.from_record(record) == settings


@pytest.mark.parametrize("name", METHODS)
def test_every_method_copies_compares_hashes_pickles_and_records_itself(name: str, temple: BuiltInScene) -> None:
    method = METHODS[name]()
    assert pickle.loads(pickle.dumps(method)) == method == copy.deepcopy(method)  # noqa: S301
    assert hash(METHODS[name]()) == hash(method)
    settings = Settings(carving=method)
    record = json.loads(json.dumps(settings.record()))
    assert record["carving"]["name"] == name
    assert set(record["carving"]["options"]) == {option.name for option in fields(method)}
    assert Settings.from_record(record) == settings
    assert settings.resolved(temple.scene).carving == method


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"views": "some"}, "expected views 'auto', 'all' or a tuple of names, got 'some'"),
        ({"views": ()}, "expected views"),
        ({"views": 3}, "expected views"),
        ({"matching": 3}, "expected matching"),
        ({"views": "all", "max_views": 3}, "expected views 'auto' with max_views=3, got 'all'"),
        ({"views": ("a",), "max_views": 3}, "expected views 'auto' with max_views=3"),
        ({"max_views": 0}, "expected max_views to be a whole number of at least 1, got 0"),
        ({"max_views": True}, "expected max_views to be a whole number of at least 1, got True"),
        ({"n_voxels": -5}, "expected n_voxels to be a whole number of at least 1, got -5"),
        ({"n_voxels": 1e6}, "expected n_voxels to be a whole number"),
        ({"n_voxels": 10**400}, r"n_voxels to be a whole number from 1 to 9007199254740992, got 10{36}\.\.\.0{20}$"),
        ({"n_voxels": True}, "expected n_voxels to be a whole number"),
        ({"n_voxels": 1000, "voxel_size": 0.1}, "expected n_voxels or voxel_size, got both: 1000 and 0.1"),
        ({"voxel_size": float("nan")}, r"expected voxel_size to be a number in \(0, inf\), got nan"),
        ({"voxel_size": 0}, "expected voxel_size"),
        ({"carving": "voxel-coloring"}, "expected carving by one of VisualHull, .*, got 'voxel-coloring'"),
        ({"carving": recon3d.VisualHull}, "expected carving by one of VisualHull"),
        ({"matching": "dense"}, r"expected matching 'auto', None or a tuple of Matching, got 'dense'"),
        ({"matching": ()}, "expected one or more passes of matching"),
        ({"matching": Matching()}, "expected matching"),
        ({"meshing": {"surface": "poisson"}}, "expected meshing to be a Meshing"),
        ({"meshing": Meshing(fill_hidden=True)}, "fill_hidden: expected a one-sided carving method"),
        (
            {"meshing": Meshing(fill_hidden=True), "carving": SpaceCarving()},
            "fill_hidden: expected a one-sided carving method",
        ),
        (
            {
                "meshing": Meshing(fill_hidden=True),
                "carving": recon3d.VoxelColoring(),
                "matching": PASSES,
            },
            "fill_hidden: expected matching=None",
        ),
        ({"meshing": Meshing(smoothing=0), "matching": PASSES}, "smoothing: expected matching=None"),
        ({"meshing": Meshing("graph-cut"), "matching": None}, "surface='graph-cut': expected matching"),
        ({"meshing": Meshing("graph-cut"), "carving": recon3d.VisualHull()}, "surface='graph-cut': expected matching"),
    ],
)
def test_nothing_given_is_ignored(bad: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Settings(**bad)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"surface": "delaunay"}, "expected surface poisson, graph-cut, got 'delaunay'"),
        ({"smoothing": -1}, "expected smoothing to be a whole number of at least 0, got -1"),
        ({"smoothing": True}, "expected smoothing"),
        ({"min_component": -1}, r"expected min_component to be a number in \[0, inf\), got -1"),
        ({"min_component": float("nan")}, "expected min_component"),
        ({"keep_unsupported": 1}, "expected keep_unsupported to be True or False, got 1"),
        ({"triangles": 3}, "expected triangles to be a whole number of at least 4, got 3"),
        ({"fill_hidden": "yes"}, "expected fill_hidden to be True or False, got 'yes'"),
    ],
)
def test_bad_meshing_is_refused(bad: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Meshing(**bad)


@pytest.mark.parametrize(
    ("method", "bad"),
    [
        (method, {name: value})
        for method in METHODS.values()
        for name, values in {
            "max_rounds": (0, -3, 2.5, True),
            "rounds": (0, 1.5),
            "connectivity": (7, 6.0, True, "6"),
            "layering": ("rings",),
            "test": (3, None, StandardDeviation),
            "min_score": (1, -1, float("nan"), "0.5"),
            "truncation": (0, float("inf")),
            "tolerance": (-1, 0.5),
            "sigma0": (0, float("nan")),
            "prior": (0, 1),
            "threshold": (0, 1.5),
            "initial": (0, 1),
            "outliers": (-0.1, 1),
        }.items()
        for value in values
        if name in {option.name for option in fields(method)}
    ],
)
def test_a_methods_impossible_options_are_refused(method: type[Method], bad: dict[str, Any]) -> None:
    (name, value), *_ = bad.items()
    with pytest.raises(ArgumentError, match=rf"expected .*{'test' if name == 'test' else name}.*, got "):
        method(**bad)
    assert value is not None or name == "test"


def test_what_auto_means_depends_on_the_silhouettes(temple: BuiltInScene) -> None:
    scene, bare = temple.scene, without_silhouettes(temple.scene)
    known, unknown = Settings().resolved(scene), Settings().resolved(bare)
    assert known == Settings(
        n_voxels=1_000_000, carving=recon3d.VoteCarving(), matching=PASSES, meshing=Meshing(keep_unsupported=True)
    )
    assert unknown == replace(known, meshing=Meshing(keep_unsupported=False))
    assert Settings(matching=None).resolved(bare).meshing.keep_unsupported is True
    assert known.resolved(scene) == known
    assert Settings(voxel_size=0.1).resolved(scene).n_voxels is None


def test_matching_is_left_out_where_a_method_is_chosen_unless_it_is_asked_for(
    temple: BuiltInScene,
) -> None:
    for method in (recon3d.VoteCarving(), recon3d.VisualHull(), recon3d.VoxelColoring()):
        assert Settings(carving=method).resolved(temple.scene).matching is None
        assert Settings(carving=method, matching=PASSES).resolved(temple.scene).matching == PASSES
    assert Settings(matching=None).resolved(temple.scene).matching is None


def test_what_only_the_scene_tells_to_mean_nothing_is_refused_then(temple: BuiltInScene) -> None:
    bare = without_silhouettes(temple.scene)
    lone = replace(bare, views=bare.views[:1])
    with pytest.raises(ArgumentError, match="surface='graph-cut': expected matching"):
        Settings(meshing=Meshing("graph-cut")).resolved(lone)
    with pytest.raises(ArgumentError, match="smoothing: expected matching=None"):
        Settings(meshing=Meshing(smoothing=3)).resolved(temple.scene)
    for method in (method for method in METHODS.values() if method.needs_silhouettes):
        with pytest.raises(SceneError, match="needs silhouettes, and no view has one"):
            Settings(carving=method()).resolved(bare)


def test_numbers_of_numpy_are_recorded_as_pythons_own() -> None:
    given = Settings(n_voxels=np.int64(9), carving=recon3d.VoteCarving(np.float32(0.5)))  # type: ignore[arg-type]
    assert json.loads(json.dumps(given.record())) == Settings(n_voxels=9, carving=recon3d.VoteCarving(0.5)).record()
