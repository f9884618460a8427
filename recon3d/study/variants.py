"""Which photo-consistency tests are compared: by name, as values, or swept over one parameter."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from recon3d.consistency import TESTS, load_test
from recon3d.consistency.base import ConsistencyTest
from recon3d.consistency.loading import LoadedTest

Tests = str | Iterable[str | ConsistencyTest] | Mapping[str, str | ConsistencyTest]
"""Names as ``load_test`` takes them, tests themselves, or both under labels of one's own; "all": every test."""


Sweep = tuple[str, Sequence[float]]
"""A parameter's name and the values that it takes."""


@dataclass(frozen=True)
class Variant:
    """One test with one set of parameters."""

    label: str
    test: ConsistencyTest
    family: str
    """Label of the test that the sweep varies; the label itself where it is not swept."""
    value: float | None = None
    """Of the swept parameter."""


def expand_variants(tests: Tests, sweep: Sweep | None = None) -> list[Variant]:
    """Every test that is asked for, those with the swept parameter once for each value.

    Raises
    ------
    ValueError : no such test, two of one label, a parameter that none has, or a value that a test refuses.
    """
    if sweep and not len(sweep[1]):
        raise ValueError(f"expected one or more values of {sweep[0]}")
    found = [
        variant
        for label, test in _labelled(tests)
        for variant in (_swept(label, test, *sweep) if sweep else [Variant(label, test, label)])
    ]
    labels = [variant.label for variant in found]
    repeated = sorted({label for label in labels if labels.count(label) > 1})
    if not found or repeated:
        raise ValueError(f"expected tests of different labels, got {', '.join(repeated) or 'none'}")
    if sweep and all(variant.value is None for variant in found):
        known = sorted({name for variant in found for name in _parameters(variant.test)})
        raise ValueError(f"expected a parameter among {', '.join(known) or 'none'}, got {sweep[0]!r}")
    return found


def _labelled(tests: Tests) -> list[tuple[str, ConsistencyTest]]:
    """Labels and tests, loaded."""
    if isinstance(tests, Mapping):
        named: list[tuple[str, str | ConsistencyTest]] = list(tests.items())
    else:
        listed = list(TESTS) if tests == "all" else [tests] if isinstance(tests, str) else list(tests)
        named = [(test if isinstance(test, str) else _label(test), test) for test in listed]
    return [(label, load_test(test) if isinstance(test, str) else test) for label, test in named]


def _label(test: ConsistencyTest) -> str:
    """What a test that was given as a value is called: its name, and what is not as usual."""
    if is_dataclass(test):
        unusual = [f"{f.name}={getattr(test, f.name)}" for f in fields(test) if getattr(test, f.name) != f.default]
        return " ".join([type(test).__name__, *unusual])
    made_by = test.func if isinstance(test, partial) else test
    return str(getattr(made_by, "__name__", "") or repr(made_by))


def _parameters(test: ConsistencyTest) -> list[str]:
    """Names of what can be varied: what a class is made with, or what a function takes beside the patches."""
    if isinstance(test, LoadedTest):
        made = test.test
        of_class = not (inspect.isfunction(made) or isinstance(made, partial))
        return list(inspect.signature(type(made)).parameters) if of_class else _parameters(made)
    if is_dataclass(test):
        return [f.name for f in fields(test)]
    return list(inspect.signature(test).parameters)[1:]


def _swept(label: str, test: ConsistencyTest, name: str, values: Sequence[float]) -> list[Variant]:
    """The test with every value of a parameter; as it is where it has no such parameter."""
    if name not in _parameters(test):
        return [Variant(label, test, label)]
    found = []
    for value in np.asarray(values).tolist():  # plain numbers, which have one text
        try:
            change: dict[str, Any] = {name: value}
            varied = _varied(test, change)
        except ValueError as error:
            raise ValueError(f"{label}, {name}={value:g}: {error}") from None
        found.append(Variant(f"{label} {name}={value:g}", varied, label, value))
    return found


def _varied(test: ConsistencyTest, change: dict[str, Any]) -> ConsistencyTest:
    """The test with other parameters."""
    if isinstance(test, LoadedTest):
        return load_test(test.path, **{**test.options, **change})
    return replace(test, **change) if is_dataclass(test) else partial(test, **change)
