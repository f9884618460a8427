"""What a photo-consistency test is called, what it was made with, and what tells it from every other."""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from inspect import isfunction
from typing import Any

import numpy as np

from recon3d.consistency.base import AroundTest, ConsistencyTest, Patches, Verdict
from recon3d.consistency.failures import failure
from recon3d.consistency.hysteresis import Hysteresis
from recon3d.consistency.loading import LoadedTest, load_by_path
from recon3d.consistency.table import TESTS
from recon3d.errors import ArgumentError, DataError, FailedTestError

_KINDS: dict[str, Any] = {**TESTS, "hysteresis": Hysteresis}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def load_test(name: str, /, **options: object) -> ConsistencyTest:
    """A photo-consistency test by name: one of ``TESTS``, or the user's own as "module:name".

    The module is imported from the current directory or wherever Python finds it. A class is called with the options;
    a function of the patches is the test itself, with the options as further keywords.

    Raises
    ------
    ArgumentError : no such test, module or name, not callable, or options it does not take; one line.
    FailedTestError : the user's code raised something else; one line with the place in their code.
    """
    if ":" in name:
        return load_by_path(name, options)
    if name not in TESTS:
        raise ArgumentError(f"expected a test among {', '.join(TESTS)}, or module:name, got {name!r}")
    return _made(name, options)


def ask(test: ConsistencyTest, patches: Patches) -> Verdict:
    """What a test says of patches.

    Raises
    ------
    FailedTestError : a user's test raised something, or gave no verdict on each voxel; one line.
    """
    try:
        verdict = test(patches)
    except Exception as error:
        if is_built_in(test):
            raise
        raise failure(f"the test {name_of(test)} failed", error) from error
    if not isinstance(verdict, Verdict):
        raise FailedTestError(f"the test {name_of(test)}: expected a Verdict, got {type(verdict).__name__}")
    if len(verdict.degree) != patches.n_voxels:
        raise FailedTestError(f"the test {name_of(test)} judged {len(verdict.degree)} voxels of {patches.n_voxels}")
    return verdict


def name_of(test: Any) -> str:
    """Name of a built-in test; module:name of a user's that can be made again by it, else module.name."""
    if isinstance(test, LoadedTest):
        return test.path
    if isinstance(test, partial):
        return name_of(test.func)
    kind = test if isfunction(test) else type(test)
    if kind in _NAMES:
        return _NAMES[kind]
    return f"{kind.__module__}{':' if isfunction(test) or is_dataclass(test) else '.'}{kind.__qualname__}"


def is_built_in(test: ConsistencyTest) -> bool:
    """Whether all code of a test is the package's."""
    return name_of(test) in _KINDS and (not isinstance(test, AroundTest) or is_built_in(test.test))


def options_of(test: Any) -> dict[str, Any]:
    """What a test was made with, as far as that can be told from outside."""
    if isinstance(test, LoadedTest):
        return dict(test.options)
    if isinstance(test, partial):
        return {**options_of(test.func), **test.keywords}
    if is_dataclass(test) and not isinstance(test, type):
        return {option.name: getattr(test, option.name) for option in fields(test)}
    return {}


def label_of(test: ConsistencyTest) -> str:
    """What a test that was given as a value is called for short: its name, and what is not as usual."""
    if is_dataclass(test):
        unusual = [f"{f.name}={getattr(test, f.name)}" for f in fields(test) if getattr(test, f.name) != f.default]
        return " ".join([type(test).__name__, *unusual])
    made_by = test.func if isinstance(test, partial) else test
    return str(getattr(made_by, "__name__", "") or repr(made_by))


def parameters_of(test: ConsistencyTest) -> list[str]:
    """Names of what can be varied: what a class is made with, or what a function takes beside the patches."""
    if isinstance(test, LoadedTest):
        made = test.test
        of_class = not (isfunction(made) or isinstance(made, partial))
        return list(inspect.signature(type(made)).parameters) if of_class else parameters_of(made)
    if is_dataclass(test):
        return [option.name for option in fields(test)]
    return list(inspect.signature(test).parameters)[1:]


def varied(test: ConsistencyTest, **change: Any) -> ConsistencyTest:
    """The test with other parameters."""
    if isinstance(test, LoadedTest):
        return load_test(test.path, **{**test.options, **change})
    return replace(test, **change) if is_dataclass(test) else partial(test, **change)


def record_of(test: ConsistencyTest) -> dict[str, Any]:
    """Name and options of a test, and of a test inside a test, as JSON takes them."""
    options = {name: _recorded(value) for name, value in options_of(test).items()}
    return {"name": name_of(test), "options": options}


def restore(record: Mapping[str, Any], users_own: str | None = None) -> ConsistencyTest:
    """The test that a record, which may come from anyone, tells of.

    Nothing is imported or called that the record alone names: a test is one of ``TESTS``, ``Hysteresis`` around one,
    or the one that the user names.

    Parameters
    ----------
    users_own : module:name of the user's own test that the record may stand for.

    Raises
    ------
    ArgumentError : the options are not those of the test.
    DataError : the record holds no name and options, or tells of a test of a user's own that was not named.

    Warns
    -----
    UserWarning : the user's own test has another name than the recorded one.
    """
    name, options = record.get("name"), record.get("options")
    if not (isinstance(name, str) and isinstance(options, Mapping)):
        raise DataError(f"expected the name and the options of a test, got {record!r}")
    values = {option: _restored(value, users_own) for option, value in options.items()}
    if name in _KINDS:
        return _made(name, values)
    if users_own is None:
        raise DataError(
            f"the test {name} is not the package's own, and code is not run because a file names it: "
            "if it is yours, name it by --test module:name"
        )
    if users_own == name:
        return load_test(users_own, **values)
    warnings.warn(f"the recorded test is {name}, and {users_own} is used with its own defaults", stacklevel=2)
    return load_test(users_own)


def identity(test: ConsistencyTest) -> str | None:
    """Text that tells a test from every other, with the source that it is made of.

    None where that cannot be told from outside: closures, objects with a state of their own, a notebook's functions.
    """
    if isinstance(test, LoadedTest):  # the source that its path names may differ from its own
        return _joined(test.path, [*test.options.items(), identity(test.test)])
    if isinstance(test, partial):
        return _joined(test.func, [*test.args, *test.keywords.items()])
    if is_dataclass(test) and not isinstance(test, type):
        return _joined(type(test), list(options_of(test).items()))
    return _joined(test, []) if isfunction(test) and test.__closure__ is None else None


def _made(name: str, options: Mapping[str, Any]) -> ConsistencyTest:
    """A built-in test of a name."""
    known = [option.name for option in fields(_KINDS[name])]
    unknown = [option for option in options if option not in known]
    if unknown:
        raise ArgumentError(f"{name} has no option {', '.join(unknown)}; it has {', '.join(known) or 'none'}")
    test: ConsistencyTest = _KINDS[name](**options)
    return test


def _recorded(value: Any) -> Any:
    """A parameter as JSON takes it."""
    return record_of(value) if callable(value) else value.item() if isinstance(value, np.generic) else value


def _restored(value: Any, users_own: str | None) -> Any:
    """A parameter as it was before it went through JSON: a tuple, a test, or itself."""
    if isinstance(value, list):
        return tuple(value)
    return restore(value, users_own) if isinstance(value, Mapping) and "name" in value else value


def _joined(made_by: Any, parameters: Sequence[Any]) -> str | None:
    """Identity of what a class or function, itself or its path "module:name", makes of parameters."""
    try:
        named = isinstance(made_by, str)
        module, name = made_by.split(":") if named else (made_by.__module__, made_by.__qualname__)
        if module == "__main__":
            return None
        source = inspect.getsource(sys.modules[module])
    except (OSError, TypeError, KeyError, AttributeError):
        return None
    told = [_told(parameter) for parameter in parameters]
    return None if None in told else "\n".join([name, *map(str, told), source])


def _told(value: Any) -> str | None:
    """A parameter as text; None where text would not tell all of it."""
    if callable(value):
        return identity(value)
    if isinstance(value, tuple):
        parts = [_told(part) for part in value]
        return None if None in parts else str(parts)
    return repr(value) if value is None or isinstance(value, bool | int | float | str) else None
