"""Photo-consistency tests by name, the user's own among them."""

from __future__ import annotations

import json
import pickle
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from batches import outcome, patches_of

from recon3d.carving.voxel_coloring import VoxelColoring
from recon3d.consistency import TESTS, load_test
from recon3d.consistency.base import ConsistencyTest, Patches, Verdict
from recon3d.consistency.hysteresis import Hysteresis
from recon3d.consistency.minkowski import Minkowski
from recon3d.consistency.spec import ask
from recon3d.consistency.specular import Specular
from recon3d.errors import ArgumentError, DataError, FailedTestError
from recon3d.io.files import write_json
from recon3d.settings import Settings

RAISES = '    raise ZeroDivisionError("two\\nlines")'
SOURCE = f"""
import numpy as np
from recon3d.consistency import Verdict

class AtLeast:
    def __init__(self, level=0.5):
        if level > 1:
            raise ValueError("expected a level of 1 or less")
        self.level = level
    def __call__(self, patches):
        limit = np.full(patches.n_voxels, self.level)
        return Verdict(np.full(patches.n_voxels, 0.7), limit, limit)

def of_level(patches, level=0.5):
    return AtLeast(level)(patches)

def broken(patches):
{RAISES}

class Nothing:
    pass

ready = AtLeast(0.9)
number = 3
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A current directory with modules of the user's."""
    (tmp_path / "users_own_tests.py").write_text(SOURCE)
    (tmp_path / "users_broken.py").write_text("import a_module_that_is_not_there\n")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in ("users_own_tests", "users_broken"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("AtLeast", {}, 1),
        ("AtLeast", {"level": 0.8}, -1),
        ("of_level", {}, 1),
        ("of_level", {"level": 0.8}, -1),
        ("ready", {}, -1),
    ],
)
def test_a_users_own_test_is_loaded_from_the_current_directory(
    here: Path, name: str, options: dict[str, object], expected: int
) -> None:
    before = list(sys.path)
    test = load_test(f"users_own_tests:{name}", **options)
    assert outcome(test(patches_of([[[[1, 2, 3]]]]))).tolist() == [expected]
    assert sys.path == before
    assert Path(sys.modules["users_own_tests"].__file__ or "").parent == here


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("nowhere_to_be_found:Test", {}, "no module 'nowhere_to_be_found' in"),
        ("users_own_tests.inner:Test", {}, "no module 'users_own_tests.inner' in"),
        ("users_own_tests:Missing", {}, "users_own_tests has no Missing"),
        ("users_own_tests:number", {}, "expected a class or function, got int"),
        ("users_own_tests:Nothing", {}, "a Nothing cannot be called"),
        ("users_own_tests:AtLeast", {"hight": 1}, "hight"),
        ("users_own_tests:AtLeast", {"level": 2}, "expected a level of 1 or less"),
        ("users_own_tests:of_level", {"hight": 1}, "hight"),
        (":AtLeast", {}, "expected module:name"),
        ("users_own_tests:", {}, "expected module:name"),
        ("fuzzi", {}, "expected a test among fuzzy, .* or module:name, got 'fuzzi'"),
        ("fuzzy", {"level": 1}, "fuzzy has no option level; it has intensity, trim"),
    ],
)
@pytest.mark.usefixtures("here")
def test_what_cannot_be_loaded_is_said_in_one_line(name: str, options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load_test(name, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("here")
def test_a_module_that_fails_when_it_is_imported_is_named_with_the_place() -> None:
    with pytest.raises(FailedTestError, match=r"^cannot import users_broken: ModuleNotFoundError: .*broken.py:1\)"):
        load_test("users_broken:Test")


def test_what_a_users_own_test_raises_is_said_in_one_line_with_its_name_and_place(here: Path) -> None:
    patches = patches_of([[[[1, 2, 3]]]])
    place = f"({here / 'users_own_tests.py'}:{1 + SOURCE.splitlines().index(RAISES)})"
    for test in (load_test("users_own_tests:broken"), Hysteresis(load_test("users_own_tests:broken"))):
        with pytest.raises(FailedTestError) as caught:
            ask(test, patches)
        assert str(caught.value).endswith(f" failed: ZeroDivisionError: two lines {place}")
        assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_a_bad_verdict_of_a_users_test_is_its_failure() -> None:
    def beyond(patches: Patches) -> Verdict:
        return Verdict(np.full(patches.n_voxels, 2.0), np.zeros(patches.n_voxels), np.zeros(patches.n_voxels))

    patches = patches_of([[[[1, 2, 3]]]])
    with pytest.raises(FailedTestError, match=rf"beyond failed: ArgumentError: expected every degree .*{__file__}:"):
        ask(beyond, patches)
    with pytest.raises(FailedTestError, match="expected a Verdict, got int"):
        ask(lambda _: 3, patches)  # type: ignore[arg-type,return-value]
    with pytest.raises(FailedTestError, match="judged 0 voxels of 1"):
        ask(lambda patches: Minkowski()(patches.part(0, 0)), patches)


def test_an_error_inside_a_test_of_the_package_is_not_the_users() -> None:
    with pytest.raises(AttributeError):
        ask(Hysteresis(Minkowski()), None)  # type: ignore[arg-type]


def test_the_tests_of_the_package_load_by_their_names() -> None:
    for name, kind in TESTS.items():
        assert load_test(name) == kind()
    assert load_test("minkowski", norm="l1") == Minkowski("l1")


@pytest.mark.usefixtures("here")
def test_the_record_of_a_run_names_a_users_own_test_and_its_options() -> None:
    for test, expected in (
        (load_test("users_own_tests:AtLeast"), ("users_own_tests:AtLeast", {})),
        (load_test("users_own_tests:of_level"), ("users_own_tests:of_level", {})),
        (load_test("users_own_tests:AtLeast", level=0.8), ("users_own_tests:AtLeast", {"level": 0.8})),
        (load_test("users_own_tests:of_level", level=0.8), ("users_own_tests:of_level", {"level": 0.8})),
        (load_test("users_own_tests:of_level").test, ("users_own_tests:of_level", {})),
        (load_test("users_own_tests:of_level", level=0.8).test, ("users_own_tests:of_level", {"level": 0.8})),
        (load_test("users_own_tests:AtLeast").test, ("users_own_tests.AtLeast", {})),
        (Hysteresis(load_test("users_own_tests:AtLeast")),
         ("hysteresis", {"test": {"name": "users_own_tests:AtLeast", "options": {}}, "margin": 0.05})),
        (Hysteresis(Minkowski("l1", 3.0), None),
         ("hysteresis", {"test": {"name": "minkowski", "options": {"norm": "l1", "threshold": 3.0}}, "margin": None})),
    ):  # fmt: skip
        record = Settings(carving=VoxelColoring(test)).record()["carving"]["options"]["test"]
        assert record == {"name": expected[0], "options": expected[1]}
        json.dumps(record)


def through_json(settings: Settings, folder: Path, users_own: str | None = None) -> Settings:
    record = json.loads(write_json(folder / "record.json", settings.record()).read_text())
    return Settings.from_record(record, test=users_own)


def recorded(test: ConsistencyTest, folder: Path, users_own: str | None = None) -> ConsistencyTest:
    """A test after its way through a record."""
    method = through_json(Settings(carving=VoxelColoring(test)), folder, users_own).carving
    assert isinstance(method, VoxelColoring)
    return method.test


@pytest.mark.parametrize("name", TESTS)
def test_settings_come_back_from_their_record(name: str, tmp_path: Path) -> None:
    for test in (load_test(name), Hysteresis(load_test(name)), Hysteresis(load_test(name), None)):
        settings = Settings(carving=VoxelColoring(test, connectivity=6))
        assert through_json(settings, tmp_path) == settings


@pytest.mark.usefixtures("here")
def test_parameters_of_tests_come_back_from_their_record(tmp_path: Path) -> None:
    for test in (Minkowski("l1", 3.0), Specular(light=(250.0, 200.0, 100.0)), Hysteresis(Minkowski("linf"), 0.2)):
        assert recorded(test, tmp_path) == test


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("name", "options"),
    [("AtLeast", {}), ("AtLeast", {"level": 0.8}), ("of_level", {"level": 0.8}), ("of_level", {}), ("ready", {})],
)
def test_a_users_own_test_comes_back_from_its_record(name: str, options: dict[str, object], tmp_path: Path) -> None:
    loaded = load_test(f"users_own_tests:{name}", **options)
    patches = patches_of([[[[1, 2, 3]]]])
    for test in (loaded, Hysteresis(loaded)):
        again = recorded(test, tmp_path, f"users_own_tests:{name}")
        assert again == test
        assert outcome(again(patches)).tolist() == outcome(test(patches)).tolist()


@pytest.mark.usefixtures("here")
def test_a_loaded_test_still_asks_for_what_it_needs() -> None:
    (Path.cwd() / "users_own_tests.py").write_text(SOURCE + "AtLeast.needs_directions, AtLeast.window_side = True, 7\n")
    loaded = load_test("users_own_tests:AtLeast")
    assert loaded.needs_directions is True  # type: ignore[attr-defined]
    assert loaded.window_side == 7  # type: ignore[attr-defined]


def test_what_a_record_does_not_tell_is_not_made_up() -> None:
    class Opaque:
        def __call__(self, patches: Patches) -> Verdict:
            return Minkowski()(patches)

    with pytest.raises(DataError, match=r"the test .*Opaque is not the package's own, .*--test module:name"):
        Settings.from_record(Settings(carving=VoxelColoring(Opaque())).record())
    with pytest.raises(ValueError, match="unknown settings colour"):
        Settings.from_record({"colour": 1})


HOSTILE = "subprocess:Popen"


@pytest.mark.parametrize("name", [HOSTILE, "os:system", "subprocess.Popen", "builtins:exec", "a_module:Test"])
@pytest.mark.parametrize("around", [False, True])
def test_nothing_that_only_a_record_names_is_imported_or_called(name: str, around: bool, tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    test: dict[str, object] = {"name": name, "options": {"args": ["touch", str(marker)]}}
    if around:
        test = {"name": "hysteresis", "options": {"test": test, "margin": 0.1}}
    record = {"carving": {"name": "voxel-coloring", "options": {"test": test}}}
    with pytest.raises(DataError, match=f"the test {name} is not the package's own"):
        Settings.from_record(record)
    for carving in ({"name": name, "options": {}}, {"name": "roxels", "options": {"test": test}}, [name], name, {}):
        with pytest.raises((DataError, ArgumentError)):
            Settings.from_record({"carving": carving})
    assert "a_module" not in sys.modules
    assert not marker.exists()


@pytest.mark.parametrize(
    "record", [[], "settings", 3, {"meshing": 3}, {"meshing": []}, {"matching": [3]}, {"carving": 3}]
)
def test_what_is_no_record_of_settings_is_refused(record: object) -> None:
    with pytest.raises((DataError, ArgumentError)):
        Settings.from_record(record)  # type: ignore[arg-type]


def test_what_is_no_record_of_a_test_is_refused() -> None:
    for test in ("fuzzy", None, 3, {}, {"name": "fuzzy"}, {"name": "fuzzy", "options": []}, {"name": ["fuzzy"]}):
        with pytest.raises((DataError, ArgumentError)):
            Settings.from_record({"carving": {"name": "voxel-coloring", "options": {"test": test}}})
    for options in ({"threshold": [1]}, {"threshold": {"name": "x"}}, {"colour": 1}):
        test = {"name": "standard-deviation", "options": options}
        with pytest.raises((DataError, ArgumentError)):
            Settings.from_record({"carving": {"name": "voxel-coloring", "options": {"test": test}}})


@pytest.mark.usefixtures("here")
def test_a_users_own_test_is_made_again_only_where_it_is_named(tmp_path: Path) -> None:
    loaded = load_test("users_own_tests:AtLeast", level=0.8)
    with pytest.raises(
        DataError,
        match=r"the test users_own_tests:AtLeast is not the package's own, .*"
        r"if it is yours, name it by --test module:name",
    ):
        recorded(loaded, tmp_path)
    assert recorded(loaded, tmp_path, "users_own_tests:AtLeast") == loaded
    with pytest.warns(UserWarning, match="the recorded test is users_own_tests:AtLeast, and users_own_tests:of_level"):
        assert recorded(loaded, tmp_path, "users_own_tests:of_level") == load_test("users_own_tests:of_level")
    with pytest.raises(ArgumentError, match=r"expected no test, .* got users_own_tests:AtLeast"):
        recorded(Minkowski(), tmp_path, "users_own_tests:AtLeast")
    with pytest.raises(ArgumentError, match="expected no test"):
        Settings.from_record(Settings().record(), test="users_own_tests:AtLeast")


@pytest.mark.usefixtures("here")
def test_a_loaded_test_hashes_and_pickles() -> None:
    loaded, other = load_test("users_own_tests:AtLeast"), load_test("users_own_tests:AtLeast", level=0.7)
    assert {loaded, load_test("users_own_tests:AtLeast")} == {loaded}
    assert loaded != other
    assert pickle.loads(pickle.dumps(loaded)) == loaded  # noqa: S301
