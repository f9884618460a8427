"""Compiles what a default run uses, so that the first one need not: ``python -m recon3d.cli.precompile``."""

import os
import subprocess
import sys

_LIMIT = 600.0  # seconds; a machine that needs longer compiles in its first run


def warm_up(part: int = 0, parts: int = 1) -> None:
    """Compile the kernels of a default run, or of one of two parts of it: carving, and matching within what is carved.

    By small reconstructions of the built-in scene; what they compile is kept on disk.
    """
    import recon3d

    built_in = recon3d.little_temple(n_views=8, width=160, height=120, supersampling=1)
    runs = [
        recon3d.Settings(n_voxels=20_000, carving=recon3d.VoteCarving(), matching=None),
        recon3d.Settings(n_voxels=20_000, carving=recon3d.VisualHull(), matching=recon3d.stereo.PASSES),
    ]
    for settings in runs[part::parts]:
        recon3d.reconstruct(built_in.scene, settings, ground_truth=built_in.ground_truth)


def main() -> int:
    """Compile both parts side by side where there are two cores."""
    parts = min(2, os.cpu_count() or 1)
    command = [
        sys.executable,
        "-c",
        "import sys; from recon3d.cli.precompile import warm_up; warm_up(*map(int, sys.argv[1:]))",
    ]
    processes = [subprocess.Popen([*command, str(part), str(parts)]) for part in range(parts)]  # noqa: S603
    try:
        return max(abs(process.wait(_LIMIT)) for process in processes)
    except subprocess.TimeoutExpired:
        return 1
    finally:
        for process in processes:
            process.kill()


if __name__ == "__main__":
    sys.exit(main())
