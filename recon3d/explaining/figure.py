"""The picture of an explanation: crops of the photographs, luminances, degree and thresholds, neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from recon3d.carving.observer import Judgement
from recon3d.explaining.evidence import PixelKind, ViewEvidence
from recon3d.volume.carved import Label

_COLUMNS = 6


_LABEL_COLORS = {
    Label.UNSEEN: "#eeeeee",
    Label.BACKGROUND: "#c7d7ee",
    Label.INCONSISTENT: "#f3b6a6",
    Label.HIDDEN: "#c9c9c9",
    Label.CONSISTENT: "#b9e0b4",
}


_KINDS = {
    PixelKind.VOTED: ("voted", "#00d000"),
    PixelKind.TAKEN: ("shows something else", "#ff9000"),
    PixelKind.FOREGROUND: ("foreground, not asked", "#b0b0b0"),
    PixelKind.BACKGROUND: ("background", "#3080ff"),
}


@dataclass(frozen=True)
class NeighbourSlices:
    """The voxel and its 26 neighbours."""

    labels: NDArray[np.int64]
    """(3, 3, 3) ``Label``; -1 outside the volume."""
    degrees: NDArray[np.float64]
    """(3, 3, 3); NaN where the test was not asked."""
    through: tuple[int, ...] | None
    """(3,) index, 0 to 2, of the neighbour that connects a candidate."""


def draw_explanation(
    title: str,
    views: Sequence[ViewEvidence],
    judgements: Sequence[Judgement],
    neighbours: NeighbourSlices,
) -> NDArray[np.uint8]:
    """(height, width, 3) RGB picture of everything.

    Parameters
    ----------
    views : those that see the voxel.
    judgements : all of them, the last being the decisive one.
    """
    voting = [view for view in views if view.count(PixelKind.VOTED)]
    rows = -(-len(views) // _COLUMNS)
    columns = max(-(-len(views) // max(rows, 1)), 4)
    heights = (max(2.35 * rows, 0.4), max(2.9, 1.4 + 0.14 * len(voting)))  # inches
    figure = Figure(figsize=(2.0 * columns, 0.9 + sum(heights)), layout="constrained", dpi=100)
    figure.suptitle(fill(title, 22 * columns), fontsize=11, x=0.01, ha="left")
    upper, lower = np.asarray(figure.subfigures(2, 1, height_ratios=heights))
    shown = voting + [view for view in views if not view.count(PixelKind.VOTED)]
    for cell, view in zip(upper.subplots(max(rows, 1), columns, squeeze=False).flat, shown, strict=False):
        _draw_crop(cell, view)
    for cell in [axes for axes in upper.axes if not axes.images]:
        cell.axis("off")
    present = {kind for view in views for kind in np.unique(view.kinds)}
    handles = [
        Line2D([], [], marker="s", ls="", mfc="none", mec=color, mew=2, label=name)
        for kind, (name, color) in _KINDS.items()
        if kind in present
    ]
    if handles:
        upper.legend(handles=handles, loc="outside lower left", ncols=len(_KINDS), fontsize=8, frameon=False)
    left, right = np.asarray(lower.subfigures(1, 2))
    pixels, scale = left.subplots(2, 1, height_ratios=(3, 1))
    _draw_luminances(pixels, voting)
    _draw_scale(scale, judgements)
    right.suptitle("degrees of the voxel (bold) and its neighbours\ngreen: accepted; red: carved", fontsize=8)
    for k, axes in enumerate(right.subplots(1, 3)):
        _draw_slice(axes, neighbours, k)
    canvas: Any = FigureCanvasAgg(figure)  # matplotlib's canvases are not typed
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw_crop(axes: Axes, view: ViewEvidence) -> None:
    """The surroundings of a voxel's box, each of its pixels framed in the colour of its kind."""
    u0, u1, v0, v1 = view.box
    half = 0.5 * max(u1 - u0 + 1, v1 - v0 + 1)
    reach = half + max(8.0, 2.0 * half)
    u, v = (u0 + u1) / 2, (v0 + v1) / 2
    axes.imshow(view.image, interpolation="nearest")
    axes.set(xlim=(u - reach, u + reach), ylim=(v + reach, v - reach), xticks=[], yticks=[], facecolor="white")
    axes.add_patch(Rectangle((u0 - 0.5, v0 - 0.5), u1 - u0 + 1, v1 - v0 + 1, fc="none", ec="white", lw=2.5))
    thin = min(1.5, 9.0 / reach)  # points, so that a pixel's own colour shows within its frame
    # One image instead of many frames where pixels are too small for them.
    if view.kinds.size <= 400:
        for row, column in np.ndindex(view.kinds.shape):
            color = _KINDS[PixelKind(int(view.kinds[row, column]))][1]
            axes.add_patch(Rectangle((u0 + column - 0.4, v0 + row - 0.4), 0.8, 0.8, fc="none", ec=color, lw=thin))
    else:
        tints = np.array([to_rgba(_KINDS[kind][1], 0.4) for kind in PixelKind])
        axes.imshow(tints[view.kinds], extent=(u0 - 0.5, u1 + 0.5, v1 + 0.5, v0 - 0.5), interpolation="nearest")
        axes.set(xlim=(u - reach, u + reach), ylim=(v + reach, v - reach))
    voted, taken = view.count(PixelKind.VOTED), view.count(PixelKind.TAKEN)
    told = "excludes it" if view.excludes else f"{voted} of {view.kinds.size} voted" if voted + taken else ""
    axes.set_title(f"{view.name}\n{told}", fontsize=8, color="#c02000" if view.excludes else "black")


def _draw_luminances(axes: Axes, views: Sequence[ViewEvidence]) -> None:
    """Every voting pixel at its luminance, in its own colour, a line for each view."""
    if not views:
        axes.axis("off")
        axes.text(0.5, 0.5, "no test asked a pixel", ha="center", va="center", fontsize=9, transform=axes.transAxes)
        return
    for row, view in enumerate(views):
        values, colors = view.luminances, view.colors / 255
        axes.scatter(values, np.full(len(values), row), c=colors, edgecolors="#777777", linewidths=0.5, s=34)
    axes.set(xlim=(-4, 259), ylim=(len(views) - 0.4, -0.6))
    axes.set_yticks(range(len(views)), [view.name for view in views])
    axes.tick_params(labelsize=7)
    axes.set_xlabel("luminance of the pixels that voted", fontsize=8)
    axes.grid(axis="y", color="#eeeeee")
    axes.set_axisbelow(True)


def _draw_scale(axes: Axes, judgements: Sequence[Judgement]) -> None:
    """Degrees between 0 and 1 against the thresholds."""
    if not judgements:
        axes.axis("off")
        return
    degree, low, high = judgements[-1].degree, judgements[-1].low, judgements[-1].high
    carved, candidate, consistent = _LABEL_COLORS[Label.INCONSISTENT], "#ffe9a0", _LABEL_COLORS[Label.CONSISTENT]
    for start, end, color in ((0.0, low, carved), (low, high, candidate), (high, 1.0, consistent)):
        axes.axvspan(start, end, color=color, lw=0)
    for earlier in judgements[:-1]:
        axes.axvline(earlier.degree, color="#999999", lw=1, ls=":")
    axes.axvline(degree, color="black", lw=2.5)
    axes.set(xlim=(0, 1), ylim=(0, 1), yticks=[])
    both = f"{low:.3f}" if low == high else f"{low:.3f} to {high:.3f}"
    ticks = {low: f"{low:.3f}", high: f"{high:.3f}"} if high - low > 0.1 else {(low + high) / 2: both}
    axes.set_xticks([0, *ticks, 1], ["0", *ticks.values(), "1"])
    axes.tick_params(labelsize=7)
    axes.set_xlabel(f"degree {degree:.3f} (line): carved, candidate, consistent", fontsize=8)


def _draw_slice(axes: Axes, neighbours: NeighbourSlices, k: int) -> None:
    """Nine voxels of one k, i to the right, j up."""
    axes.set(xlim=(-0.5, 2.5), ylim=(-0.5, 2.5), aspect="equal")
    axes.axis("off")
    axes.set_title(("k - 1", "k", "k + 1")[k], fontsize=8)
    for i, j in np.ndindex(3, 3):
        label, degree = int(neighbours.labels[i, j, k]), neighbours.degrees[i, j, k]
        color = _LABEL_COLORS[Label(label)] if label >= 0 else "white"
        axes.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fc=color, ec="white", lw=1))
        name = Label(label).name.lower()[:6] if label >= 0 else ""
        axes.text(i, j, name if np.isnan(degree) else f"{degree:.2f}", ha="center", va="center", fontsize=7)
    bold = [((1, 1, 1), "black")] + ([(neighbours.through, "#007000")] if neighbours.through is not None else [])
    for (i, j, at_k), color in bold:
        if at_k == k:
            axes.add_patch(Rectangle((i - 0.46, j - 0.46), 0.92, 0.92, fc="none", ec=color, lw=2))
