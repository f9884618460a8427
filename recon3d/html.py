"""Small pictures and tables for notebooks."""

import base64
import html
from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray


def figure_html(title: str, rows: Mapping[str, object], picture: NDArray[np.uint8] | None = None) -> str:
    """HTML of a titled two-column table, beside an RGB picture when there is one."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(key)}</th>"
        f"<td style='text-align:left'>{html.escape(str(value))}</td></tr>"
        for key, value in rows.items()
    )
    table = f"<div><b>{html.escape(title)}</b><table>{cells}</table></div>"
    if picture is None:
        return table
    _, png = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    data = base64.b64encode(png.tobytes()).decode()
    return (
        f"<div style='display:flex;gap:1em;align-items:center'>{table}"
        f"<img src='data:image/png;base64,{data}' style='max-height:320px' alt=''></div>"
    )


def thumbnails(images: list[NDArray[np.uint8]], *, width: int, columns: int) -> NDArray[np.uint8]:
    """One RGB picture of equally wide thumbnails, row by row, padded with white."""
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
