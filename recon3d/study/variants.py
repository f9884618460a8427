"""Which photo-consistency tests are compared: by name, as values, or swept over one parameter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from recon3d.consistency import TESTS, load_test
from recon3d.consistency.base import ConsistencyTest
from recon3d.consistency.spec import label_of, parameters_of, varied
from recon3d.errors import ArgumentError

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
    ArgumentError : no such test, two of one label, a parameter that none has, or a value that a test refuses.
    """
    if sweep and not len(sweep[1]):
        raise ArgumentError(f"expected one or more values of {sweep[0]}")
    found = [
        variant
        for label, test in _labelled(tests)
        for variant in (_swept(label, test, *sweep) if sweep else [Variant(label, test, label)])
    ]
    labels = [variant.label for variant in found]
    repeated = sorted({label for label in labels if labels.count(label) > 1})
    if not found or repeated:
        raise ArgumentError(f"expected tests of different labels, got {', '.join(repeated) or 'none'}")
    if sweep and all(variant.value is None for variant in found):
        known = sorted({name for variant in found for name in parameters_of(variant.test)})
        raise ArgumentError(f"expected a parameter among {', '.join(known) or 'none'}, got {sweep[0]!r}")
    return found


def _labelled(tests: Tests) -> list[tuple[str, ConsistencyTest]]:
    """Labels and tests, loaded."""
    if isinstance(tests, Mapping):
        named: list[tuple[str, str | ConsistencyTest]] = list(tests.items())
    else:
        listed = list(TESTS) if tests == "all" else [tests] if isinstance(tests, str) else list(tests)
        named = [(test if isinstance(test, str) else label_of(test), test) for test in listed]
    return [(label, load_test(test) if isinstance(test, str) else test) for label, test in named]


def _swept(label: str, test: ConsistencyTest, name: str, values: Sequence[float]) -> list[Variant]:
    """The test with every value of a parameter; as it is where it has no such parameter."""
    if name not in parameters_of(test):
        return [Variant(label, test, label)]
    found = []
    for value in np.asarray(values).tolist():  # plain numbers, which have one text
        try:
            changed = varied(test, **{name: value})
        except ValueError as error:
            raise ArgumentError(f"{label}, {name}={value:g}: {error}") from None
        found.append(Variant(f"{label} {name}={value:g}", changed, label, value))
    return found
