"""Whatever takes or gives arrays says what shape they have."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import recon3d

PACKAGE = Path(recon3d.__file__).parent

_SIZE = r"(?:\d+(?: padding)?|[nmk]|n_\w+|[nb][xyz]|height|width|rows|columns|side|connectivity|\.\.\.)"
_TERM = rf"{_SIZE}(?: [-+*/] {_SIZE})*"
SHAPE = re.compile(rf"\((?:{_TERM},|{_TERM}(?:, {_TERM})+)\)|any shape")
"""Such as (n, 3), (n,) or (n_views, height + 1, width + 1)."""


def holds_array(annotation: ast.expr | None) -> bool:
    """Whether some array is given or taken; arrays by name and arrays of any kind have no one shape."""
    text = "" if annotation is None else ast.unparse(annotation)
    return re.search(r"(?<!\[str, )\b(NDArray|ArrayLike)\b(?!\[np\.generic)", text) is not None


def documented(path: Path) -> Iterator[tuple[str, str]]:
    """Name and docstring of all that is public in a module and annotated as an array."""
    yield from _members(ast.parse(path.read_text(encoding="utf-8")), path.relative_to(PACKAGE).as_posix())


def _members(scope: ast.Module | ast.ClassDef, place: str) -> Iterator[tuple[str, str]]:
    for node, following in zip(scope.body, [*scope.body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _members(node, f"{place} {node.name}")
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            given = [each.annotation for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            if any(map(holds_array, [*given, node.returns])):
                yield f"{place} {node.name}", ast.get_docstring(node) or ""
        elif isinstance(node, ast.FunctionDef) and node.name == "__init__" and isinstance(scope, ast.ClassDef):
            if any(holds_array(each.annotation) for each in (*node.args.args, *node.args.kwonlyargs)):
                yield place, f"{ast.get_docstring(scope)} {ast.get_docstring(node)}"
        elif isinstance(node, ast.AnnAssign) and holds_array(node.annotation):
            field = ast.unparse(node.target)
            told = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
            if not field.startswith("_"):
                yield f"{place} {field}", str(following.value.value) if told else ""


ARRAYS = [
    (name, docstring)
    for path in sorted(PACKAGE.rglob("*.py"))
    if "kernels" not in path.parts and (not path.name.startswith("_") or path.name == "__init__.py")
    for name, docstring in documented(path)
]


@pytest.mark.parametrize(("name", "docstring"), ARRAYS, ids=[name for name, _ in ARRAYS])
def test_arrays_have_a_shape_in_the_docstring(name: str, docstring: str) -> None:
    assert SHAPE.search(docstring), f"{name}: expected a shape such as (n, 3) in {docstring!r}"


def test_shapes_are_told_from_other_words_in_brackets() -> None:
    assert all(
        map(SHAPE.search, ["(n, 3)", "(n,)", "(3,)", "(n_views, height + 1, width + 1)", "(4, 4)", "(nx, ny, nz)"])
    )
    assert not any(map(SHAPE.search, ["(u, v)", "(3)", "(faces, edges)", "(not used)", "(n)", "[0, 1)", "(2, 2"]))
