"""The options of commands, as what they stand for."""

from __future__ import annotations

import ast
import math
import re
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from recon3d.checks import shorten
from recon3d.errors import ArgumentError

if TYPE_CHECKING:  # Open3D takes seconds to import, --help should not
    from recon3d.carving import Method
    from recon3d.consistency.base import ConsistencyTest


def bytes_of(text: str) -> float:
    """Bytes of a size such as 4GiB, 800 MB or 4G."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMGT])(i?)B?\s*", text)
    if not found or not float(found[1]):
        raise ArgumentError(f"--memory: expected a size such as 4GiB or 800MB, got {text!r}")
    decimal = not found[3] and text.rstrip().endswith("B")
    base = 1000.0 if decimal else 1024.0
    return float(found[1]) * base ** (1 + "kMGT".index(found[2]))


def make_test(name: str | None, options: list[str]) -> ConsistencyTest:
    """Photo-consistency test of a name, with NAME=VALUE options."""
    from recon3d.consistency import load_test

    values = keywords(options)
    try:
        return load_test(name or "fuzzy", **values)
    except ArgumentError as error:
        raise ArgumentError(f"{'--test-option' if values else '--test'}: {error}") from None


def make_method(name: str, options: list[str], test: str | None, test_options: list[str]) -> Method | None:
    """Carving method of a name, with NAME=VALUE options and a test; None where the scene is to decide."""
    from recon3d.carving import METHODS, JudgingMethod

    if name == "auto":
        if options:
            raise ArgumentError(f"--method-option: expected --method, too, got {', '.join(options)} alone")
        if test is None and not test_options:
            return None
        name = "generalized-voxel-coloring"
    if name not in METHODS:
        raise ArgumentError(f"--method: expected auto, {', '.join(METHODS)}, got {name!r}")
    kind, values = METHODS[name], keywords(options)
    if test is not None or test_options:
        if not issubclass(kind, JudgingMethod):
            raise ArgumentError(f"--test: {name} uses no photo-consistency test, got {test or 'fuzzy'}")
        values["test"] = make_test(test, test_options)
    known = [option.name for option in fields(kind)]
    unknown = [option for option in values if option not in known]
    if unknown:
        raise ArgumentError(f"--method-option: {name} has no {', '.join(unknown)}; it has {', '.join(known)}")
    return kind(**values)


def views_of(option: str) -> Any:
    """The settings' choice of views: "auto", "all" or a tuple of names."""
    return option if option in ("auto", "all") else names_of(option)


def names_of(option: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in option.split(","))


# What literal_eval raises, down to text that is nested too deeply for it.
_NO_LITERAL = (ValueError, SyntaxError, TypeError, MemoryError, RecursionError)

_MOST_SWEPT = 10_000  # values; each is a whole carving


def keywords(options: list[str]) -> dict[str, Any]:
    """Keyword arguments of NAME=VALUE options; a value that is no Python literal is text."""
    values = {}
    for option in options:
        key, sign, text = option.partition("=")
        if not sign:
            raise ArgumentError(f"expected NAME=VALUE, got {option!r}")
        try:
            values[key] = ast.literal_eval(text)
        except _NO_LITERAL:
            values[key] = text
    return values


def sweep_of(option: str) -> tuple[str, list[float]]:
    """Parameter and values of NAME=LOW:HIGH:STEP, both ends included; whole numbers stay whole."""
    name, _, text = option.partition("=")
    try:
        low, high, step = (ast.literal_eval(number) for number in text.split(":"))
        count = math.floor((high - low) / step + 1e-9) + 1
        values = [round(low + n * step, 12) for n in range(min(count, _MOST_SWEPT))]
    except (*_NO_LITERAL, ArithmeticError):
        count, values = 0, []
    if not (name and values):
        raise ArgumentError(f"--sweep: expected NAME=LOW:HIGH:STEP, got {shorten(repr(option))}")
    if count > _MOST_SWEPT:
        raise ArgumentError(f"--sweep: expected at most {_MOST_SWEPT} values, got {count} by {option!r}")
    return name, values


def numbers_of(option: str, text: str | None, form: str) -> list[float] | None:
    """Numbers of an option, as many as its form "three numbers X,Y,Z" has; None where it was not given."""
    if text is None:
        return None
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != form.count(",") + 1:
        raise ArgumentError(f"{option}: expected {form}, got {text!r}")
    return numbers


def pixel_of(text: str | None) -> tuple[str, float, float] | None:
    """View's name and pixel of an option like view01.png,80,60; None where it was not given."""
    if text is None:
        return None
    name, _, numbers = text.partition(",")
    place = numbers_of("--pixel", numbers, "a view's name and two numbers U,V") or []
    return name, place[0], place[1]
