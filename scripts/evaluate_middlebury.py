"""Measure a reconstruction of a Middlebury set (metres) against its ground truth, as the paper does.

Usage: python scripts/evaluate_middlebury.py RECON GROUND_TRUTH [--output DIR]
"""

from pathlib import Path
from typing import Annotated

import typer

import recon3d


def main(
    reconstruction: Annotated[Path, typer.Argument(metavar="RECON", help="Mesh, point cloud or voxel grid.")],
    ground_truth: Annotated[Path, typer.Argument(metavar="GROUND_TRUTH", help="Mesh or points, same frame.")],
    output: Annotated[Path, typer.Option(help="Folder for the JSON and the curves.")] = Path("evaluation"),
    valid: Annotated[Path | None, typer.Option(help="Part of GROUND_TRUTH that is real data.")] = None,
    supported: Annotated[bool, typer.Option(help="Measure only vertices with support > 0.")] = False,
    accuracy_percent: float = 90.0,
    completeness_threshold_mm: float = 1.25,
    seed: int = 0,
) -> None:
    """Print accuracy and completeness; write them with their curves."""
    evaluation = recon3d.evaluation.evaluate_files(
        reconstruction,
        ground_truth,
        valid=valid,
        supported=supported,
        accuracy_percent=accuracy_percent,
        completeness_threshold_mm=completeness_threshold_mm,
        seed=seed,
    )
    print(f"accuracy     {evaluation.accuracy_mm:.2f} mm  ({accuracy_percent:g}% of the reconstruction)")
    print(f"completeness {evaluation.completeness_percent:.1f} %   (within {completeness_threshold_mm:g} mm)")
    for path in recon3d.reporting.save_evaluation(evaluation, output).values():
        print(path)


if __name__ == "__main__":
    try:
        typer.run(main)
    except (recon3d.Recon3dError, ValueError, OSError) as error:
        raise SystemExit(f"Error: {error}") from None
