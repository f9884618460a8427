"""A user's own photo-consistency test, from a module of theirs."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from inspect import isfunction, signature
from pathlib import Path

from recon3d.consistency.base import AroundTest, ConsistencyTest, Patches, Verdict


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

    def __call__(self, patches: Patches) -> Verdict:
        """The test's verdict.

        Raises
        ------
        ValueError : the test raised something; one line.
        """
        try:
            return self.test(patches)
        except Exception as error:  # whatever a user's own code does
            raise ValueError(f"{self.path}: {type(error).__name__}: {_one_line(error)}") from error


def load_by_path(path: str, options: Mapping[str, object]) -> LoadedTest:
    """The test of a path "module:name", made with the options; see ``load_test``."""
    return LoadedTest(path, dict(options), _made(path, options))


def _made(path: str, options: Mapping[str, object]) -> ConsistencyTest:
    """The test itself."""
    module, _, name = path.partition(":")
    if not (module and name):
        raise ValueError(f"expected module:name, got {path!r}")
    found = _import(module)
    for part in name.split("."):
        if not hasattr(found, part):
            raise ValueError(f"{path}: {module} has no {name}")
        found = getattr(found, part)
    if not callable(found):
        raise ValueError(f"{path}: expected a class or function, got {type(found).__name__}")
    try:
        if isfunction(found):
            # A function is the test; its first argument are the patches.
            signature(found).bind(None, **options)
            return partial(found, **options) if options else found
        test = found(**options) if isinstance(found, type) or options else found
    except TypeError as error:
        raise ValueError(f"{path}: {error}") from None
    if not callable(test):
        raise ValueError(f"{path}: a {type(test).__name__} cannot be called with patches")
    return test


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
            raise ValueError(f"no module {name!r} in {here} or where Python looks") from None
        raise ValueError(f"cannot import {name}: {type(error).__name__}: {_one_line(error)}") from error
    finally:
        sys.path.remove(here)


def _one_line(error: Exception) -> str:
    """What an error says."""
    return " ".join(str(error).split())
