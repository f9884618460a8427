"""What the files of a scene's views are called."""

from __future__ import annotations

import re
from collections.abc import Iterable

from recon3d.scene.scene import Scene


def file_stems(scene: Scene) -> dict[str, str]:
    """Each view's name to the stem of the files that are written of it; no two are the same, in upper case or lower.

    Folders are joined by "_", the suffix is dropped, and characters that are no letters, digits, "-" or "." become
    "_": ``a/my 001.png`` gives ``a_my_001``. Of views that would share a stem those that come later in the scene are
    numbered: ``001.png`` and ``001.jpg`` give ``001`` and ``001-2``.
    """
    return stems_of(view.name for view in scene.views)


def stems_of(names: Iterable[str]) -> dict[str, str]:
    """The same of names."""
    stems: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        *folders, last = re.split(r"[/\\]+", name)
        parts = (part for part in (*folders, re.sub(r"(?<=.)\.\w+$", "", last)) if part not in ("", ".", ".."))
        plain = re.sub(r"[^\w.-]+", "_", "_".join(parts)) or "view"
        stem, n = plain, 1
        while stem.casefold() in taken:
            n += 1
            stem = f"{plain}-{n}"
        taken.add(stem.casefold())
        stems[name] = stem
    return stems
