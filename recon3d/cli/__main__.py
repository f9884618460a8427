"""``python -m recon3d.cli``."""

from recon3d.cli import main

main()
