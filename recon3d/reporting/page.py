"""A report as one Markdown and one HTML file, pictures beside them."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from recon3d.errors import ArgumentError
from recon3d.io.files import write_text

_STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:76em;margin:2em auto;padding:0 1em}p{max-width:60em}"
    "table{border-collapse:collapse}td,th{text-align:left;padding:.2em .8em;border-bottom:1px solid #ccc}"
    ".row{display:flex;gap:.5em;align-items:flex-end}figure{margin:.3em 0}img{max-width:100%}figcaption{font-size:85%}"
)


@dataclass(frozen=True)
class Section:
    """A part of a page: paragraphs, then a table, then pictures."""

    title: str
    text: Sequence[str] = ()
    """Paragraphs, plain."""
    table: Sequence[Sequence[str]] = ()
    """Rows of equally many cells, the head first."""
    pictures: Sequence[Sequence[tuple[str, str]]] = ()
    """Rows of (path relative to the page, caption)."""

    def __post_init__(self) -> None:
        if len({len(row) for row in self.table}) > 1:
            raise ArgumentError(
                f"section {self.title}: expected rows of one length, got {[len(r) for r in self.table]}"
            )

    def markdown(self) -> str:
        """The section in Markdown; each row of pictures is a table of its own."""
        parts = [f"## {self.title}", *self.text]
        if self.table:
            parts.append(markdown_table(self.table))
        for row in self.pictures:
            parts.append(markdown_table([[caption for _, caption in row], [f"![]({path})" for path, _ in row]]))
        return "\n\n".join(parts)

    def html(self) -> str:
        """The section in HTML."""
        parts = [f"<h2>{html.escape(self.title)}</h2>", *(f"<p>{html.escape(text)}</p>" for text in self.text)]
        for n, row in enumerate(self.table):
            cell = "td" if n else "th"
            cells = "".join(f"<{cell}>{html.escape(text)}</{cell}>" for text in row)
            parts.append(f"{'' if n else '<table>'}<tr>{cells}</tr>")
        if self.table:
            parts.append("</table>")
        for pictures in self.pictures:
            figures = "".join(
                f"<figure><img src='{html.escape(path)}' alt=''><figcaption>{html.escape(text)}</figcaption></figure>"
                for path, text in pictures
            )
            parts.append(f"<div class='row'>{figures}</div>")
        return "\n".join(parts)


def write_page(folder: Path | str, title: str, sections: Sequence[Section]) -> dict[str, Path]:
    """Write ``index.md`` and ``index.html``, each whole or not at all; returns role to path."""
    folder = Path(folder)
    markdown = "\n\n".join([f"# {title}", *(section.markdown() for section in sections)])
    name = html.escape(title)
    head = f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{name}</title><style>{_STYLE}</style>"
    body = "\n".join([head, f"<h1>{name}</h1>", *(section.html() for section in sections), "</html>"])
    return {
        "Markdown": write_text(folder / "index.md", markdown + "\n"),
        "HTML": write_text(folder / "index.html", body + "\n"),
    }


def markdown_table(rows: Sequence[Sequence[str]], *, numbers: bool = False) -> str:
    """Table in Markdown that reads as plain text, too: the first row is its head; numbers go after the first column."""
    cells = [[cell.replace("|", r"\|") for cell in row] for row in rows]
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    rule = ["-" * width if n == 0 or not numbers else "-" * (width - 1) + ":" for n, width in enumerate(widths)]
    lines = [
        [(str.rjust if numbers and n else str.ljust)(cell, widths[n]) for n, cell in enumerate(row)] for row in cells
    ]
    return "\n".join(f"| {' | '.join(line)} |" for line in [lines[0], rule, *lines[1:]])
