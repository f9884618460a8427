"""Checks of arguments that many values and functions share."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from recon3d.errors import ArgumentError

_MOST = 2**53  # beyond it, doubles skip whole numbers


def require_whole(name: str, value: object, least: int = 1, most: int = _MOST) -> None:
    """Refuse what is no whole number of at least so much, and at most so much.

    Raises
    ------
    ArgumentError : names the argument, what was expected, and what was got.
    """
    if _is_number(value, (int, np.integer)) and least <= value <= most:  # type: ignore[operator]
        return
    unbounded = most == _MOST and not (_is_number(value, (int, np.integer)) and value > most)  # type: ignore[operator]
    expected = f"of at least {least}" if unbounded else f"from {least} to {most}"
    raise ArgumentError(f"expected {name} to be a whole number {expected}, got {shorten(repr(value))}")


def shorten(text: str, longest: int = 60) -> str:
    """A text that is too long for a message, cut in its middle."""
    return text if len(text) <= longest else f"{text[: longest - 23]}...{text[-20:]}"


def require_number(name: str, value: object, interval: str) -> None:
    """Refuse what is no finite number in an interval such as "[0, 1)" or "(0, inf)".

    Raises
    ------
    ArgumentError : names the argument, what was expected, and what was got.
    """
    low, high = (float(end) for end in interval[1:-1].split(","))
    if _is_number(value, (int, float, np.integer, np.floating)):
        number = float(value)  # type: ignore[arg-type]
        above = low <= number if interval[0] == "[" else low < number
        below = number <= high if interval[-1] == "]" else number < high
        if np.isfinite(number) and above and below:
            return
    raise ArgumentError(f"expected {name} to be a number in {interval}, got {value!r}")


def require_choice(name: str, value: object, choices: Collection[object]) -> None:
    """Refuse what is none of the choices.

    Raises
    ------
    ArgumentError : names the argument, the choices, and what was got.
    """
    if not any(type(value) is type(choice) and value == choice for choice in choices):
        raise ArgumentError(f"expected {name} {', '.join(map(str, choices))}, got {value!r}")


def require_flag(name: str, value: object) -> None:
    """Refuse what is neither True nor False.

    Raises
    ------
    ArgumentError : names the argument, and what was got.
    """
    if not isinstance(value, bool | np.bool_):
        raise ArgumentError(f"expected {name} to be True or False, got {value!r}")


def _is_number(value: object, kinds: tuple[type, ...]) -> bool:
    """Whether a value is of one of the kinds, and not True or False."""
    return isinstance(value, kinds) and not isinstance(value, bool | np.bool_)
