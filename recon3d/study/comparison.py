"""Photo-consistency tests side by side: the same scene, volume, views and visibility, one test after another."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from matplotlib.figure import Figure
from numpy.typing import NDArray

from recon3d.consistency.spec import identity
from recon3d.io.checkpoints import Checkpoints
from recon3d.io.files import atomic_path, write_image, write_json, write_text
from recon3d.pipeline import Progress
from recon3d.reporting.figures import plot_trade_off
from recon3d.reporting.page import markdown_table
from recon3d.scene.scene import Scene
from recon3d.settings import Settings
from recon3d.study.trials import Trial, set_up_trials
from recon3d.study.variants import Sweep, Tests, expand_variants
from recon3d.summary import Summarised, grid_html
from recon3d.tasks import Arrays, Kept, content_key, once

_COLUMNS: dict[str, tuple[str, str]] = {
    "accepted": ("accepted", ",.0f"),
    "holes": ("holes", ",.0f"),
    "floating": ("floating", ",.0f"),
    "roughness_degrees": ("roughness (deg)", ".1f"),
    "accuracy_mm": ("accuracy (mm)", ".2f"),
    "completeness_percent": ("completeness (%)", ".1f"),
    "precision_percent": ("precision (%)", ".1f"),
    "median_error": ("median error", ".1f"),
    "rms_error": ("RMS error", ".1f"),
    "overlap_percent": ("overlap (%)", ".1f"),
    "carving_s": ("carving (s)", ".2f"),
    "memory_mib": ("memory (MiB)", ".0f"),
}
"""Heading and format of each of a trial's figures in the table."""


_AXES = (
    ("completeness_percent", "precision_percent", "better: to the right and up"),
    ("overlap_percent", "median_error", "better: to the right and down"),
    ("accepted", "median_error", ""),
)
"""What the trade-off is drawn of, the first pair that is known, and how it is read."""


@dataclass(frozen=True, repr=False)
class Comparison(Summarised):
    """What every test made of the same views of the same volume."""

    conditions: dict[str, Any]
    """What was the same for all: scene, settings, names of the views used and of those held out, for a JSON file."""
    trials: tuple[Trial, ...]
    sheet: NDArray[np.uint8]
    """(height, width, 3) RGB contact sheet: the photographs, and what each test made of them from the same cameras."""

    def table(self) -> list[list[str]]:
        """Heading and one row for each test; a column of which nothing is known is left out."""
        known = [name for name in _COLUMNS if any(getattr(trial, name) is not None for trial in self.trials)]
        rows = [["test", *(_COLUMNS[name][0] for name in known)]]
        for trial in self.trials:
            values = [getattr(trial, name) for name in known]
            cells = ["-" if value is None else format(value, _COLUMNS[name][1])
                     for name, value in zip(known, values, strict=True)]  # fmt: skip
            rows.append([trial.label, *cells])
        return rows

    def markdown(self) -> str:
        """Title, table and what its columns mean, as Markdown that reads as plain text, too."""
        return "\n\n".join([self._title(), markdown_table(self.table(), numbers=True), self._notes()]) + "\n"

    def plot(self) -> Figure:
        """The trade-off: how much of the object each test finds against how right that is.

        Precision against completeness where a ground truth was given, else re-projection error against overlap with
        the silhouettes, or against the number of voxels. Swept tests are lines; tests that left nothing are not shown.
        """
        figures = [asdict(trial) for trial in self.trials]
        known = (
            axes for axes in _AXES if any(row[axes[0]] is not None and row[axes[1]] is not None for row in figures)
        )
        x, y, title = next(known, _AXES[-1])
        points: dict[str, list[tuple[float, float, str]]] = {}
        for row in figures:
            if row[x] is not None and row[y] is not None:
                told = "" if row["value"] is None else f"{row['value']:g}"
                points.setdefault(row["family"], []).append((row[x], row[y], told))
        return plot_trade_off(points, xlabel=_COLUMNS[x][0], ylabel=_COLUMNS[y][0], title=title)

    def save(self, folder: Path | str) -> dict[str, Path]:
        """Write figures (JSON), table (Markdown), contact sheet and trade-off (PNG); returns role to path."""
        folder = Path(folder)
        with atomic_path(folder / "trade_off.png") as temporary:
            self.plot().savefig(temporary, dpi=120)
        return {
            "table": write_text(folder / "comparison.md", self.markdown()),
            "contact sheet": write_image(folder / "contact_sheet.png", self.sheet),
            "trade-off": folder / "trade_off.png",
            "figures": write_json(folder / "comparison.json", self.record()),
        }

    def record(self) -> dict[str, Any]:
        """Conditions and figures for a JSON file."""
        return {**self.conditions, "trials": [asdict(trial) for trial in self.trials]}

    def summary(self) -> dict[str, object]:
        """The figures of each test in one line."""
        heading, *rows = self.table()
        return {
            row[0]: ", ".join(f"{name} {cell}" for name, cell in zip(heading[1:], row[1:], strict=True)) for row in rows
        }

    def picture(self) -> NDArray[np.uint8]:
        """(height, width, 3) RGB contact sheet."""
        return self.sheet

    def _repr_html_(self) -> str:
        return grid_html(self._title(), self.table(), self._notes(), self.sheet)

    def _title(self) -> str:
        c = self.conditions
        return f"{c['scene']}, {c['settings']['carving']['name']}, {len(c['views'])} views, {c['voxels']:,} voxels"

    def _notes(self) -> str:
        held_out = self.conditions["held_out"]
        measured = f"views held out ({', '.join(held_out)})" if held_out else "views that the tests used"
        notes = (
            f"Re-projection errors in grey levels, and overlap with the silhouettes, by the {measured}. "
            "Accepted: voxels; holes: handles and rims of the mesh; floating: pieces beside the largest, small "
            "components included; roughness: mean angle between neighbouring triangles; memory: what a run adds to "
            "the process."
        )
        if truth := self.conditions["evaluation"]:
            notes += (
                f" Accuracy: the distance that {truth['accuracy_percent']:g}% of the mesh keep; completeness and "
                "precision: shares of ground truth and mesh that lie within "
                f"{truth['completeness_threshold_mm']:g} mm of the other."
            )
        return notes


def compare(
    scene: Scene,
    tests: Tests = "all",
    *,
    settings: Settings | None = None,
    ground_truth: o3d.geometry.TriangleMesh | o3d.geometry.PointCloud | None = None,
    sweep: Sweep | None = None,
    hold_out: int | Sequence[str] = 4,
    folder: Path | str | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Comparison:
    """Carve, mesh and measure with one photo-consistency test after another, all else being equal.

    Tests run in this process, so that they may be functions of a notebook. Each is run on a thousand voxels first:
    what is compiled or loaded then is not in its seconds.

    Parameters
    ----------
    tests : names as in ``TESTS`` or "module:name", tests, or a mapping of labels to either; "all": all of ``TESTS``.
    settings : all but the test; voxel colouring of a million voxels when None.
    ground_truth : in the scene's frame; accuracy, completeness and precision are measured against it.
    sweep : a parameter and its values; tests that have it are run with each, the others once.
    hold_out : hold out every n-th of the views that the method admits, and measure the re-projection error on those:
        how well a result predicts what it was not made of. 0: none, and the error is measured on the views used. Or
        the names of the views. ``settings.max_views`` counts what is left.
    folder : where each finished test is kept, in ``trials``; one that is there, of the same inputs, is not run again.
        The source of a test counts as input; of one that is made in ``__main__`` nothing is kept.
    options : passed to ``evaluate``, such as ``valid``.

    Raises
    ------
    ArgumentError : a test, parameter or view that is not there, or a method that uses no test; before any work.
    VisibilityError, VolumeTooLargeError : as in ``reconstruct``.
    """
    entries = expand_variants(tests, sweep)
    setup = set_up_trials(scene, settings, hold_out, ground_truth, options)
    conditions = setup.fingerprint()
    # A folder for each set of conditions: who goes back to earlier ones finds their trials.
    store = Checkpoints(Path(folder) / "trials" / conditions[:16]) if folder is not None else None
    report = progress or (lambda _stage, _done, _total: None)
    trials, rows = [], [setup.row("photographs", [view.image for view in setup.shown.views])]
    for n, entry in enumerate(entries):
        report("tests", n, len(entries))
        told = identity(entry.test)
        kept = Kept(store if told else None, content_key(conditions, entry.label, told), _arrays, _restored)
        trial, row = once(setup.run, entry.label, (entry, report), kept=kept)
        trials.append(trial)
        rows.append(row)
        report("tests", n + 1, len(entries))
    return Comparison(setup.record(), tuple(trials), np.vstack(rows))


def _arrays(found: tuple[Trial, NDArray[np.uint8]]) -> Arrays:
    """A trial and its row of the contact sheet for a file."""
    return {"figures": np.array(json.dumps(asdict(found[0]))), "row": found[1]}


def _restored(arrays: Arrays) -> tuple[Trial, NDArray[np.uint8]]:
    """The trial and row of arrays that were kept."""
    return Trial(**json.loads(str(arrays["figures"]))), arrays["row"]
