"""Text, JSON, XML and numbers of scene files, which are data and may be anyone's."""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from recon3d.errors import DataError

_MOST_TEXT = 512 * 2**20  # bytes of a text file
_LARGEST_SIDE = 1_000_000  # pixels
_FEWEST_BYTES = 8  # that tell UTF-16 without a mark
_MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises
    ------
    DataError : not JSON, or no object.
    """
    try:
        content = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not readable as JSON: {error}") from None
    if not isinstance(content, dict):
        raise DataError(f"{path}: expected a JSON object, got a {type(content).__name__}")
    return content


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file, which may declare no entities.

    Raises
    ------
    DataError : not XML.
    """
    text = read_text(path)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DataError(f"{path}: expected XML without a document type of its own")
    try:
        return ElementTree.fromstring(text.encode())  # noqa: S314 -- what can be attacked needs a document type
    except (ElementTree.ParseError, ValueError) as error:
        raise DataError(f"{path}: not readable as XML: {error}") from None


def read_text(path: Path, most: int = _MOST_TEXT) -> str:
    """A text file, whether UTF-8 or UTF-16, with or without byte-order mark, or else Windows' Western letters.

    Parameters
    ----------
    most : bytes.

    Raises
    ------
    DataError : longer.
    """
    if path.stat().st_size > most:
        raise DataError(f"{path}: expected at most {most} bytes of text, got {path.stat().st_size}")
    content = path.read_bytes()
    for mark, coding in _MARKS.items():
        if content.startswith(mark):
            return content[len(mark) :].decode(coding, errors="replace")
    for first, coding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if len(content) >= _FEWEST_BYTES and not any(content[first:_FEWEST_BYTES:2]):
            return content.decode(coding, errors="replace")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def number_fields(text: str, counts: Collection[int]) -> list[str]:
    """Fields of a line of numbers between blanks, commas or semicolons, in the form that ``float`` reads.

    Commas are decimal ones where semicolons stand between the numbers, or where there are no decimal points and the
    blanks alone make an expected count of fields. Exponents may be D, as Fortran writes them.
    """
    plain = re.sub(r"[()\[\]{}]", " ", text).replace("\u2212", "-")
    fields = re.split(r"[;\s]+", plain.strip("; \t")) if ";" in plain else [part.strip(",") for part in plain.split()]
    fields = [field for field in fields if field]
    if "." not in plain and (";" in plain or len(fields) in counts):
        fields = [field.replace(",", ".") for field in fields]
    elif len(fields) not in counts:
        fields = [field for field in re.split(r"[,;\s]+", plain) if field]
    return [re.sub(r"(?<=[\d.])[dD](?=[-+]?\d)", "e", field) for field in fields]


def numbers(values: Iterable[Any], count: int | tuple[int, ...], where: str) -> NDArray[np.float64]:
    """(n,) finite numbers of a text's fields, or of nested lists, as many as are expected.

    Raises
    ------
    DataError : others, or no numbers.
    """
    expected = (count,) if isinstance(count, int) else count
    try:
        array = np.array([float(value) for value in _flat(values)])
    except (TypeError, ValueError, OverflowError):
        raise DataError(f"{where}: expected {' or '.join(map(str, expected))} numbers, got {values!r:.200}") from None
    if len(array) not in expected or not np.isfinite(array).all():
        raise DataError(
            f"{where}: expected {' or '.join(map(str, expected))} finite numbers, got {len(array)}: {values!r:.200}"
        )
    return array


def _flat(values: Iterable[Any]) -> Iterator[Any]:
    for value in values:
        if isinstance(value, (list, tuple, np.ndarray)):
            yield from _flat(value)
        else:
            yield value


def entries(content: Mapping[str, Any], part: str, where: str) -> list[dict[str, Any]]:
    """Objects of a list in a JSON file.

    Raises
    ------
    DataError : no list of objects.
    """
    found = content.get(part)
    if not isinstance(found, list) or not all(isinstance(entry, dict) for entry in found):
        raise DataError(f"{where}: expected a list '{part}' of objects")
    return found


def whole(value: Any, where: str) -> int:
    """A width or height in pixels.

    Raises
    ------
    DataError : none.
    """
    number = float(numbers((value,), 1, where)[0])
    if number != int(number) or not 0 < number < _LARGEST_SIDE:
        raise DataError(f"{where}: expected a whole number of pixels, got {number:g}")
    return int(number)
