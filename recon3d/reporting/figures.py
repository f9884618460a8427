"""Plots of an evaluation, and a mesh that turns under the mouse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.evaluation.distances import Evaluation
from recon3d.io.files import atomic_path, write_json

if TYPE_CHECKING:  # they take a second to import, and most runs draw nothing
    import plotly.graph_objects as go
    from matplotlib.figure import Figure


def plot_evaluation(evaluation: Evaluation, title: str = "") -> Figure:
    """Histograms of both distances and their cumulative distributions (the paper's Fig. 7)."""
    from matplotlib.figure import Figure

    curves = evaluation.curves()
    largest = curves["distance_mm"][-1]
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    edges = np.linspace(0, largest, 51)
    sides = (("reconstruction to ground truth", evaluation.accuracy_distances, "tab:blue"),
             ("ground truth to reconstruction", evaluation.completeness_distances, "tab:orange"))  # fmt: skip
    for label, distances, color in sides:
        left.hist(distances, edges, weights=_percent(distances), histtype="step", label=label, color=color)
    left.set(xlabel="distance (mm)", ylabel="share of samples (%)", title=title or "Distances")
    left.legend()
    right.plot(curves["distance_mm"], curves["reconstruction_within_percent"], label="R within distance of G")
    right.plot(curves["distance_mm"], curves["ground_truth_within_percent"], label="G within distance of R")
    right.plot(evaluation.accuracy_mm, evaluation.accuracy_percent, "o", color="tab:blue",
               label=f"accuracy: {evaluation.accuracy_percent:g}% within {evaluation.accuracy_mm:.2f} mm")  # fmt: skip
    right.plot(evaluation.completeness_threshold_mm, evaluation.completeness_percent, "s", color="tab:orange",
               label=f"completeness: {evaluation.completeness_percent:.1f}% within "
                     f"{evaluation.completeness_threshold_mm:g} mm")  # fmt: skip
    right.set(xlabel="distance (mm)", ylabel="samples within (%)", ylim=(0, 101), xlim=(0, largest))
    right.legend(loc="lower right")
    return figure


def plot_trade_off(
    series: Mapping[str, Sequence[tuple[float, float, str]]], *, xlabel: str, ylabel: str, title: str = ""
) -> Figure:
    """Named series of points (x, y, text) in one plane: what gains in one direction costs in the other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.6), layout="constrained")
    axes = figure.subplots()
    for n, (name, points) in enumerate(series.items()):
        x, y, texts = zip(*points, strict=True)
        axes.plot(x, y, marker="osD^vP*X"[n % 8], alpha=0.7, label=name)
        for point in zip(x, y, texts, strict=True):
            axes.annotate(point[2], point[:2], xytext=(4, 4), textcoords="offset points", fontsize=8)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    axes.set_title(title, fontsize=10)
    if series:
        figure.legend(loc="outside right upper")
    return figure


def save_evaluation(evaluation: Evaluation, folder: Path | str) -> dict[str, Path]:
    """Write the figures with both curves as JSON, and their plot as PNG; returns role to path."""
    folder = Path(folder)
    figure = plot_evaluation(evaluation)
    with atomic_path(folder / "evaluation.png") as temporary:
        figure.savefig(temporary, dpi=120)
    record = {**evaluation.record(), "curves": evaluation.curves()}
    return {
        "curves": folder / "evaluation.png",
        "evaluation": write_json(folder / "evaluation.json", record),
    }


def show_mesh(mesh: o3d.geometry.TriangleMesh, *, max_triangles: int = 60_000) -> go.Figure:
    """Interactive figure of a coloured mesh for a notebook; large meshes are simplified for it."""
    import plotly.graph_objects as go

    if len(mesh.triangles) > max_triangles:
        mesh = mesh.simplify_quadric_decimation(max_triangles)
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    colors = np.rint(255 * np.clip(np.asarray(mesh.vertex_colors), 0, 1)) if mesh.has_vertex_colors() else None
    surface = go.Mesh3d(
        **dict(zip("xyz", vertices.T, strict=True)),
        **dict(zip("ijk", triangles.T, strict=True)),
        vertexcolor=colors,
        lighting={"ambient": 0.7, "diffuse": 0.4, "specular": 0.02},
        hoverinfo="skip",
    )
    hidden = {"visible": False}
    scene = {"aspectmode": "data", "xaxis": hidden, "yaxis": hidden, "zaxis": hidden}
    return go.Figure(surface, layout={"scene": scene, "margin": dict.fromkeys("lrtb", 0), "height": 500})


def _percent(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weight of each sample in a histogram that sums to 100."""
    return np.full(len(samples), 100.0 / len(samples))
