"""The command line."""

from recon3d.cli.entry import main

__all__ = [
    "main",
]
