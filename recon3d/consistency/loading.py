"""A user's own photo-consistency test, from a module of theirs."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from inspect import isfunction, signature
from pathlib import Path
from typing import Any

from recon3d.consistency.base import AroundTest, ConsistencyTest, Patches, Verdict
from recon3d.consistency.failures import failure
from recon3d.errors import ArgumentError


@dataclass(frozen=True, repr=False)
class LoadedTest(AroundTest):
    """A user's own test, and how to make it again."""

    path: str
    """Where it was found, as "module:name"."""
    options: Mapping[str, object]
    """What it was made with."""
    test: ConsistencyTest = field(compare=False)
    """Judges."""

    def __repr__(self) -> str:
        options = ", ".join(f"{name}={value!r}" for name, value in self.options.items())
        return f"{self.path}({options})" if options else self.path

    def __hash__(self) -> int:
        return hash(self.path)

    def __call__(self, patches: Patches) -> Verdict:
        """The test's verdict."""
        return self.test(patches)


def load_by_path(path: str, options: Mapping[str, object]) -> LoadedTest:
    """The test of a path "module:name", made with the options; see ``load_test``."""
    return LoadedTest(path, dict(options), _made(path, options))


def _made(path: str, options: Mapping[str, object]) -> ConsistencyTest:
    """The test itself."""
    found = _found(path)
    is_function = isfunction(found)
    try:
        if is_function:  # it is the test; its first argument are the patches
            signature(found).bind(None, **options)
        elif isinstance(found, type):
            signature(found).bind(**options)
    except TypeError as error:
        raise ArgumentError(f"{path}: {error}") from None
    if is_function:
        return partial(found, **options) if options else found
    try:
        test: object = found(**options) if isinstance(found, type) or options else found
    except ValueError as error:  # an option that the user's class refuses
        raise ArgumentError(f"{path}: {error}") from error
    except Exception as error:
        raise failure(path, error) from error
    if not callable(test):
        raise ArgumentError(f"{path}: a {type(test).__name__} cannot be called with patches")
    return test


def _found(path: str) -> Any:
    """The class, function or object of a path "module:name"."""
    module, _, name = path.partition(":")
    if not (module and name):
        raise ArgumentError(f"expected module:name, got {path!r}")
    found: Any = _import(module)
    for part in name.split("."):
        if not hasattr(found, part):
            raise ArgumentError(f"{path}: {module} has no {name}")
        found = getattr(found, part)
    if not callable(found):
        raise ArgumentError(f"{path}: expected a class or function, got {type(found).__name__}")
    return found


def _import(name: str) -> object:
    """The module of a name, also from the current directory."""
    here = str(Path.cwd())
    importlib.invalidate_caches()
    sys.path.insert(0, here)
    try:
        return importlib.import_module(name)
    except Exception as error:  # whatever a user's module does while it is imported
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing and (name == missing or name.startswith(f"{missing}.")):
            raise ArgumentError(f"no module {name!r} in {here} or where Python looks") from None
        raise failure(f"cannot import {name}", error) from error
    finally:
        sys.path.remove(here)
