"""What a check of a scene has found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing that is, or may be, wrong with a scene."""

    kind: str
    """Short name, such as "opengl axes" or "one wrong camera"."""
    message: str
    """What is wrong and how it shows, in one or two sentences that name views."""
    advice: str
    """What to do about it."""
    views: tuple[str, ...] = ()
    """Names of the views that it is about; empty: all."""
    about: str = "photographs"
    """What is wrong: "cameras", "bounds", "masks" or "photographs"."""

    def covers(self, about: str) -> bool:
        """Whether it tells what a doubt about bounds, masks or cameras comes from, too."""
        return self.about in (about, "cameras")

    def __str__(self) -> str:
        return f"{self.message} {self.advice}"
