"""How values show themselves: one line in a terminal, a table and a picture in a notebook."""

from __future__ import annotations

import base64
import html
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray


class Summarised(ABC):
    """A value that is told by a table, and perhaps a picture, instead of all its arrays."""

    @abstractmethod
    def summary(self) -> Mapping[str, object]:
        """Rows of the table."""

    def picture(self) -> NDArray[np.uint8] | None:
        """(height, width, 3) RGB picture, or None."""
        return None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}: {value}' for name, value in self.summary().items())})"

    def _repr_html_(self) -> str:
        return _figure_html(type(self).__name__, self.summary(), self.picture())


def _figure_html(title: str, rows: Mapping[str, object], picture: NDArray[np.uint8] | None) -> str:
    """HTML of a titled two-column table, beside an RGB picture when there is one."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(key)}</th>"
        f"<td style='text-align:left'>{html.escape(str(value))}</td></tr>"
        for key, value in rows.items()
    )
    table = f"<div><b>{html.escape(title)}</b><table>{cells}</table></div>"
    if picture is None:
        return table
    return (
        f"<div style='display:flex;gap:1em;align-items:center'>{table}{_image_html(picture, 'max-height:320px')}</div>"
    )


def _image_html(picture: NDArray[np.uint8], style: str) -> str:
    """HTML of an embedded RGB picture."""
    _, png = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    data = base64.b64encode(png.tobytes()).decode()
    return f"<img src='data:image/png;base64,{data}' style='{style}' alt=''>"


def grid_html(title: str, rows: Sequence[Sequence[str]], notes: str, picture: NDArray[np.uint8]) -> str:
    """HTML of a titled table with a heading row and column, above notes and an RGB picture (height, width, 3)."""
    heading, *body = rows
    cells = "".join(f"<th>{html.escape(name)}</th>" for name in heading)
    lines = [f"<tr>{cells}</tr>"]
    for first, *others in body:
        cells = "".join(f"<td style='text-align:right'>{html.escape(cell)}</td>" for cell in others)
        lines.append(f"<tr><th style='text-align:left'>{html.escape(first)}</th>{cells}</tr>")
    table = f"<b>{html.escape(title)}</b><table>{''.join(lines)}</table><p>{html.escape(notes)}</p>"
    return f"<div>{table}{_image_html(picture, 'max-width:100%')}</div>"


def labelled_row(label: str, images: list[NDArray[np.uint8]], *, width: int) -> NDArray[np.uint8]:
    """(height, width, 3) equally wide RGB pictures beside a label, word by word below each other, on white."""
    pictures = thumbnails(images, width=width, columns=len(images))
    row = np.full((max(pictures.shape[0], 20 * len(label.split()) + 8), width + pictures.shape[1], 3), 255, np.uint8)
    for n, word in enumerate(label.split()):
        cv2.putText(row, word, (6, 20 * (n + 1)), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    row[: pictures.shape[0], width:] = pictures
    return row


def thumbnails(images: Iterable[NDArray[np.uint8]], *, width: int, columns: int) -> NDArray[np.uint8]:
    """(height, width, 3) RGB picture of equally wide thumbnails, row by row, padded with white."""
    small = []
    for image in images:
        height = max(1, round(image.shape[0] * width / image.shape[1]))
        small.append(np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8))
    cell = max(image.shape[0] for image in small)
    n_rows = -(-len(small) // columns)
    sheet = np.full((n_rows * cell, min(columns, len(small)) * width, 3), 255, np.uint8)
    for n, image in enumerate(small):
        row, column = divmod(n, columns)
        sheet[row * cell : row * cell + image.shape[0], column * width : (column + 1) * width] = image
    return sheet
