"""What to tell of a folder that no reader knows."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

from recon3d.scene.mask_files import IMAGE_SUFFIXES

_LOOKED_AT = 2000  # files at most
_NEAREST = {
    r"\.(mp4|mov|avi|mkv)$": "a video has no calibration: take frames out of it, and calibrate them, e.g. by COLMAP",
    r"\.log$": "a trajectory (*.log, as of Tanks and Temples) holds poses alone, no intrinsics: give K beside it, as "
    "below, or the COLMAP model it was made from",
    r"(traj|trajectory|groundtruth)[^/]*\.(txt|csv)$": "a trajectory (as of TUM or EuRoC) holds poses alone, no "
    "intrinsics: give K beside it, as below",
    r"sfm_data\.bin$": "OpenMVG's binary file: make sfm_data.json of it by openMVG_main_ConvertSfM_DataFormat",
    r"\.abc$": "AliceVision (Meshroom): take cameras.sfm of the same node, or export COLMAP's format by "
    "aliceVision_exportColmap",
    r"\.rcproj$|\.rsproj$": "RealityCapture or RealityScan: export COLMAP's format",
    r"\.(psx|psz)$": "a Metashape project: export its cameras (File, Export, Export Cameras, Agisoft XML)",
    r"\.nvm$": "VisualSFM: convert it to COLMAP's format",
    r"\.mvs$": "OpenMVS: the COLMAP, OpenMVG or Metashape files that it was made from are read",
    r"database\.db$": "a COLMAP database without a model: run colmap mapper first",
    r"\.(npy|npz|mat|pkl)$": "matrices of an unknown layout: give them as below",
}
_EXAMPLE = """In Python any cameras will do:
    import numpy as np, recon3d
    scene = recon3d.Scene.from_arrays(image_files, K, cam_from_world, bounds=(low, high))  # n files, 3x3, n x 3 x 4
    recon3d.save(recon3d.reconstruct(scene), "out")"""


def told_unknown(path: Path, signs: Sequence[str]) -> str:
    """Message: what was expected, what lies there, what that looks like, and how to go on."""
    files = [path] if path.is_file() else [file for file in islice(path.rglob("*"), _LOOKED_AT) if file.is_file()]
    expected = f"{path}: not a known scene; expected {', '.join(signs[:-1])}{' or ' if signs[1:] else ''}{signs[-1]}."
    images = [file for file in files if file.suffix.lower() in IMAGE_SUFFIXES]
    other = Counter(file.suffix.lower() or file.name for file in files if file.suffix.lower() not in IMAGE_SUFFIXES)
    holds = [f"{len(images)} images"] * bool(images) + [f"{n} {end}" for end, n in other.most_common(5)]
    near = [text for sign, text in _NEAREST.items() if any(re.search(sign, file.name.lower()) for file in files)]
    if images and not other:
        near = [f"photographs without calibration: find their cameras by recon3d calibrate {path} --output SCENE"]
    return "\n".join(
        [
            f"{expected} It holds {', '.join(holds) or 'nothing'}.",
            *(f"Nearest: {text}." for text in near),
            _EXAMPLE,
        ]
    )
