from __future__ import annotations

from pathlib import Path

import pytest

from recon3d.reporting.page import Section, write_page

SECTION = Section(
    "One & two",
    ["Before <the table>."],
    [("", "a|b"), ("row", "1 < 2")],
    [[("pictures/left.png", "left"), ("pictures/right.png", "right")]],
)


def test_a_page_holds_the_same_in_markdown_and_in_html(tmp_path: Path) -> None:
    written = write_page(tmp_path / "new", "Title", [SECTION, Section("Bare")])
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["index.html", "index.md"]
    assert written["Markdown"].read_text().splitlines() == [
        "# Title", "",
        "## One & two", "",
        "Before <the table>.", "",
        "|     | a\\|b  |", "| --- | ----- |", "| row | 1 < 2 |", "",
        "| left                   | right                   |", "| ---------------------- | ----------------------- |",
        "| ![](pictures/left.png) | ![](pictures/right.png) |", "",
        "## Bare",
    ]  # fmt: skip
    page = written["HTML"].read_text()
    assert "<h2>One &amp; two</h2>\n<p>Before &lt;the table&gt;.</p>" in page
    assert "<table><tr><th></th><th>a|b</th></tr>\n<tr><td>row</td><td>1 &lt; 2</td></tr>\n</table>" in page
    assert page.index("src='pictures/left.png'") < page.index("src='pictures/right.png'") < page.index("<h2>Bare</h2>")


def test_rows_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match=r"section Bad: expected rows of one length, got \[2, 1\]"):
        Section("Bad", table=[("a", "b"), ("c",)])
