from __future__ import annotations

import base64
import re

import cv2
import numpy as np
from numpy.typing import NDArray

from recon3d.summary import Summarised, grid_html, labelled_row, thumbnails


class Told(Summarised):
    def summary(self) -> dict[str, object]:
        return {"a <b>": 1, "c": "<script>"}


class Shown(Told):
    def picture(self) -> NDArray[np.uint8]:
        return np.full((4, 6, 3), (10, 20, 200), np.uint8)


def test_a_value_is_told_in_one_line() -> None:
    assert repr(Told()) == "Told(a <b>: 1, c: <script>)"


def test_the_table_is_escaped() -> None:
    page = Told()._repr_html_()
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "a &lt;b&gt;" in page
    assert "<img" not in page


def test_the_picture_is_embedded_in_its_own_colours() -> None:
    found = re.search(r"data:image/png;base64,([^']+)", Shown()._repr_html_())
    assert found
    image = cv2.imdecode(np.frombuffer(base64.b64decode(found[1]), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(image[..., ::-1], Shown().picture())


def test_thumbnails_stand_in_rows_padded_with_white() -> None:
    images = [np.full((20, 40, 3), 10 * n, np.uint8) for n in range(1, 4)] + [np.full((40, 40, 3), 40, np.uint8)]
    sheet = thumbnails(images[:3], width=20, columns=2)
    assert sheet.shape == (20, 40, 3)
    assert (sheet[:10, :20] == 10).all()
    assert (sheet[:10, 20:] == 20).all()
    assert (sheet[10:, :20] == 30).all()
    assert (sheet[10:, 20:] == 255).all()
    mixed = thumbnails(images, width=20, columns=9)
    assert mixed.shape == (20, 80, 3)
    assert (mixed[10:, :60] == 255).all()
    assert (mixed[:, 60:] == 40).all()


def test_a_table_of_many_columns_is_escaped() -> None:
    page = grid_html("<a>", [["name", "x"], ["<b>", "1"]], "<c>", Shown().picture())
    assert "<p>&lt;c&gt;</p><img" in page
    assert "&lt;a&gt;" in page
    assert "&lt;b&gt;</th><td style='text-align:right'>1</td>" in page


def test_a_label_stands_beside_its_pictures_and_never_on_them() -> None:
    grey = np.full((10, 20, 3), 120, np.uint8)
    row = labelled_row("incomprehensibilities of words", [grey, grey], width=20)
    assert row.shape == (68, 60, 3)  # three words need more height than the pictures
    assert (row[:10, 20:] == 120).all()
    assert (row[:, :20] < 255).any()
