"""Public photographs with known cameras that ``download`` brings."""

from __future__ import annotations

from dataclasses import dataclass

_MIDDLEBURY = "https://vision.middlebury.edu/mview/data/data"
_SEITZ = (
    "S. M. Seitz, B. Curless, J. Diebel, D. Scharstein, R. Szeliski: A comparison and evaluation of multi-view stereo "
    "reconstruction algorithms, CVPR 2006"
)


@dataclass(frozen=True)
class Dataset:
    """Photographs in one zip archive."""

    url: str
    what: str
    citation: str
    """The paper to cite."""
    sha256: str | None = None
    """Hexadecimal SHA-256 of the archive; None where it is not known, so that it cannot be checked."""


_TEMPLE, _DINO = "a plaster temple, 16 cm tall", "a plaster dinosaur, 9 cm tall, hardly any texture"

DATASETS: dict[str, Dataset] = {
    "templeSparseRing": Dataset(f"{_MIDDLEBURY}/templeSparseRing.zip", f"16 views around {_TEMPLE}", _SEITZ),
    "templeRing": Dataset(f"{_MIDDLEBURY}/templeRing.zip", f"47 views around {_TEMPLE}", _SEITZ),
    "temple": Dataset(f"{_MIDDLEBURY}/temple.zip", f"312 views on a hemisphere over {_TEMPLE}", _SEITZ),
    "dinoSparseRing": Dataset(f"{_MIDDLEBURY}/dinoSparseRing.zip", f"16 views around {_DINO}", _SEITZ),
    "dinoRing": Dataset(f"{_MIDDLEBURY}/dinoRing.zip", f"48 views around {_DINO}", _SEITZ),
    "dino": Dataset(f"{_MIDDLEBURY}/dino.zip", f"363 views on a hemisphere over {_DINO}", _SEITZ),
}
"""The data sets by name."""
