"""What a photo-consistency test is called, and what tells it from every other."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from inspect import isfunction
from typing import Any

from recon3d.consistency import TESTS, load_test
from recon3d.consistency.base import ConsistencyTest
from recon3d.consistency.hysteresis import Hysteresis
from recon3d.consistency.loading import LoadedTest
from recon3d.errors import DataError


def identity(test: ConsistencyTest) -> str | None:
    """Text that tells a test from every other, with the source that it is made of.

    None where that cannot be told from outside: closures, objects with a state of their own, a notebook's functions.
    """
    if isinstance(test, LoadedTest):  # the source that its path names may differ from its own
        return _joined(test.path, [*test.options.items(), identity(test.test)])
    if isinstance(test, partial):
        return _joined(test.func, [*test.args, *test.keywords.items()])
    if is_dataclass(test) and not isinstance(test, type):
        return _joined(type(test), [(f.name, getattr(test, f.name)) for f in fields(test)])
    return _joined(test, []) if inspect.isfunction(test) and test.__closure__ is None else None


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


def _record_of(test: Any) -> dict[str, Any]:
    """What a test is and its parameters; a test inside a test likewise."""
    if isinstance(test, LoadedTest):
        return {"class": test.path, **test.options}
    if isinstance(test, partial):
        return {**_record_of(test.func), **test.keywords}
    known = is_dataclass(test) and not isinstance(test, type)
    parameters = {parameter.name: getattr(test, parameter.name) for parameter in fields(test)} if known else {}
    return {"class": _name_of(test), **{n: _record_of(v) if callable(v) else v for n, v in parameters.items()}}


def _name_of(test: Any) -> str:
    """Class of one of the package's tests; module:name of a user's that can be made again by it, else module.name."""
    kind = test if isfunction(test) else type(test)
    if kind in _KINDS.values():
        return str(kind.__qualname__)
    sign = ":" if isfunction(test) or is_dataclass(test) else "."
    return f"{kind.__module__}{sign}{kind.__qualname__}"


_KINDS: dict[str, Any] = {getattr(kind, "__qualname__", ""): kind for kind in (*TESTS.values(), Hysteresis)}


def _restored(value: Any) -> Any:
    """A parameter as it was before it went through JSON: a tuple, a test, or itself."""
    if isinstance(value, list):
        return tuple(value)
    return _test_of(value) if isinstance(value, dict) and "class" in value else value


def _test_of(record: Mapping[str, Any]) -> ConsistencyTest:
    """The test that a record tells of."""
    name = record["class"]
    parameters = {key: _restored(value) for key, value in record.items() if key != "class"}
    if name in _KINDS:
        test: ConsistencyTest = _KINDS[name](**parameters)
        return test
    if ":" in name:
        return load_test(name, **parameters)
    raise DataError(f"the test {name} was given as an object: its parameters are not known, so it cannot be made again")
