"""The command line."""

from recon3d.cli.commands import main

__all__ = [
    "main",
]
