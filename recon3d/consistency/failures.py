"""What went wrong inside a user's photo-consistency test."""

from __future__ import annotations

import os
import sysconfig
import traceback
from pathlib import Path

from recon3d.errors import FailedTestError

_NOT_THE_USERS = tuple(
    f"{folder}{os.sep}" for folder in (Path(__file__).parents[1], *map(sysconfig.get_path, ("stdlib", "purelib")))
)


def failure(what: str, error: Exception) -> FailedTestError:
    """The error that a user's code failed: what it is, the error, and the line of their code; one line."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith((*_NOT_THE_USERS, "<frozen ", "<string>"))]
    place = f" ({own[-1].filename}:{own[-1].lineno})" if own else ""
    return FailedTestError(f"{what}: {type(error).__name__}: {' '.join(str(error).split())}{place}")
