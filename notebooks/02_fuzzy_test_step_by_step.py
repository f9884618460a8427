# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # The fuzzy test, step by step
#
# Is a voxel on the object's surface? If it is, all photographs that see it see one spot, so their pixels should agree.
# Barhoumi, Bakkay and Zargouba (2013) measure the agreement by a degree between 0 and 1 (a fuzzy membership), and judge
# it by two thresholds (a hysteresis) that adapt to the number of views. Here is what happens, one step after the other,
# with the built-in little temple.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt
import numpy as np
import plotly.graph_objects as go

import recon3d
from recon3d.consistency.fuzzy import alternating_harmonic

scene = recon3d.little_temple(n_views=8, width=320, height=240, noise=4).scene
scene

# %% [markdown]
# ## What a test is given
#
# The volume is visited in layers, from the cameras inwards. The engine projects every voxel of a layer into the views
# and collects the pixels that no nearer voxel has claimed: the voxel's patches. A test may be anything callable, so
# this one asks the paper's own and keeps what passes through.


# %%
class Remembering:
    """The paper's test, and all that it was asked and answered, layer by layer."""

    def __init__(self):
        self.fuzzy = recon3d.FuzzyAdaptiveHysteresis()
        self.layers = []

    def __call__(self, patches):
        verdict = self.fuzzy(patches)
        self.layers.append((patches, verdict))
        return verdict


test = Remembering()
volume = recon3d.CarvingVolume.enclosing(scene.bounds, n_voxels=200_000)
hull = recon3d.VoxelColoring(test).carve(scene, volume)
hull

# %% [markdown]
# ## Step 1: the degree of one voxel (equation 7)
#
# Sort the luminances of all its pixels, leave out the lowest and the highest tenth as outliers, and divide the lowest
# of the rest by the highest. One colour everywhere gives 1. Three voxels of one layer: a poor one, a middling one, a
# good one. Every bar is a pixel in its own colour; pale ones are left out.

# %%
patches, verdict = max(test.layers, key=lambda layer: layer[0].n_voxels)
several = np.flatnonzero((np.diff(patches.starts) >= 20) & (patches.n_views >= 3))
order = several[np.argsort(verdict.degree[several])]
figure, axes = plt.subplots(1, 3, figsize=(13, 3), sharey=True, layout="constrained")
for cell, voxel in zip(axes, order[[0, len(order) // 2, -1]], strict=True):
    colors = patches.colors[patches.starts[voxel] : patches.starts[voxel + 1]]
    luminance = np.rint(colors @ [0.299, 0.587, 0.114])
    rank = np.argsort(luminance, kind="stable")
    first, ninth = (luminance[rank[max(int(np.ceil(share * len(rank) - 1e-9)), 1) - 1]] for share in (0.1, 0.9))
    kept = (luminance[rank] >= first) & (luminance[rank] <= ninth)
    shades = np.column_stack([colors[rank] / 255, np.where(kept, 1, 0.3)])
    cell.bar(range(len(rank)), luminance[rank], color=shades)
    cell.set_title(
        f"{patches.n_views[voxel]} views: {first:.0f} / {ninth:.0f} = {first / ninth:.3f}\n"
        f"the test says {verdict.degree[voxel]:.3f}"
    )
axes[0].set_ylabel("luminance")
plt.show()

# %% [markdown]
# ## Step 2: two thresholds for N views (equation 9)
#
# The partial sums of 1 - 1/2 + 1/3 - ... jump to and fro around log 2. For a voxel that N views see, the lower
# threshold is the sum of 2N terms, the upper one that of 2N + 1: with more views the two close in, and fewer degrees
# are in doubt. At or above the upper one a voxel is consistent; at or below the lower one it is carved; between, a
# candidate.

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(13, 3.6), layout="constrained")
terms = np.arange(1, 34)
left.plot(terms, alternating_harmonic(terms), ".-", color="tab:gray")
left.axhline(np.log(2), color="black", lw=0.8, ls=":")
left.set(title="S(n), the alternating harmonic series; dotted: log 2", xlabel="n terms", ylim=(0.45, 1.05))
n_views = np.arange(1, 17)
low, high = alternating_harmonic(2 * n_views), alternating_harmonic(2 * n_views + 1)
right.fill_between(n_views, high, 1, color="tab:green", alpha=0.3, label="consistent")
right.fill_between(n_views, low, high, color="gold", alpha=0.5, label="candidate")
right.fill_between(n_views, 0, low, color="tab:red", alpha=0.3, label="carved")
right.plot(n_views, high, "o-", color="tab:green", ms=4)
right.plot(n_views, low, "o-", color="tab:red", ms=4)
right.set(title="thresholds S(2N) and S(2N + 1)", xlabel="N views", ylim=(0.4, 1), xlim=(1, 16))
right.legend(loc="lower right")
plt.show()

# %% [markdown]
# Why adapt at all? The paper's Fig. 2: along the traversal, the first voxels are seen whole by some of the views, later
# ones only where nothing nearer has claimed the pixels. Means of every layer:

# %%
layers = [(patches, verdict) for patches, verdict in test.layers if patches.n_voxels]
curves = {
    "pixels of a voxel": [np.diff(patches.starts).mean() for patches, _ in layers],
    "degree": [verdict.degree.mean() for _, verdict in layers],
    "views of a voxel": [patches.n_views.mean() for patches, _ in layers],
}
figure, axes = plt.subplots(1, 3, figsize=(13, 2.6), layout="constrained")
for cell, (name, values) in zip(axes, curves.items(), strict=True):
    cell.plot(values)
    cell.set(title=name, xlabel="layer, near to far", ylim=(0, None))
plt.show()

# %% [markdown]
# ## Step 3: a whole layer
#
# The degrees of that layer's voxels with the commonest number of views, against their thresholds. No gap parts the good
# from the bad: any single threshold would cut through the crowd.

# %%
patches, verdict = max(test.layers, key=lambda layer: layer[0].n_voxels)
common = np.bincount(patches.n_views).argmax()
chosen = patches.n_views == common
figure, cell = plt.subplots(figsize=(9, 3), layout="constrained")
low, high = verdict.low[chosen][0], verdict.high[chosen][0]
zones = ((0, low, "tab:red", "carved"), (low, high, "gold", "candidates"), (high, 1, "tab:green", "consistent"))
for start, end, color, name in zones:
    cell.axvspan(start, end, color=color, alpha=0.3, lw=0, label=name)
cell.hist(verdict.degree[chosen], np.linspace(0, 1, 51), color="0.35")
cell.set(title=f"{chosen.sum()} voxels that {common} views see", xlabel="degree", ylabel="voxels", xlim=(0, 1))
cell.legend(loc="upper left")
plt.show()

# %% [markdown]
# ## Step 4: what the hysteresis adds (equation 8)
#
# A candidate stays if candidates connect it to a consistent voxel: doubt is resolved by the company that a voxel keeps.
# Candidates around consistent voxels fill what would be holes; a candidate that floats alone goes.

# %%
known = hull.n_views > 0
low, high = np.full(hull.labels.shape, np.nan), np.full(hull.labels.shape, np.nan)
low[known] = alternating_harmonic(2 * hull.n_views[known].astype(int))
high[known] = alternating_harmonic(2 * hull.n_views[known].astype(int) + 1)
candidate = known & (hull.degree > low) & (hull.degree < high)
stays = hull.labels == recon3d.Label.CONSISTENT
groups = {
    "consistent by its degree": (stays & ~candidate, "#3a923a"),
    "candidate, kept": (stays & candidate, "#e8b400"),
    "candidate, dropped": (~stays & candidate, "#d03020"),
}
{name: int(mask.sum()) for name, (mask, _) in groups.items()}

# %%
picture = np.full((*hull.labels.shape, 3), 255, np.uint8)
picture[hull.labels == recon3d.Label.INCONSISTENT] = (235, 225, 222)
for mask, color in groups.values():
    picture[mask] = [int(color[n : n + 2], 16) for n in (1, 3, 5)]
figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
for cell, share in zip(axes, (0.1, 0.45, 0.75), strict=True):
    level = int(picture.shape[2] * share)
    cell.imshow(picture[:, :, level].transpose(1, 0, 2), origin="lower", interpolation="nearest")
    cell.set_title(f"slice {level}")
    cell.axis("off")
handles = [plt.Line2D([], [], marker="s", ls="", color=color, label=name) for name, (_, color) in groups.items()]
handles.append(plt.Line2D([], [], marker="s", ls="", color="#ebe1de", label="carved by its degree"))
figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
plt.show()

# %% [markdown]
# The same in space; turn it with the mouse.

# %%
clouds = []
for name, (mask, color) in groups.items():
    points = volume.centers(mask)[:: max(1, int(mask.sum()) // 4000)]
    marker = {"size": 2, "color": color}
    x, y, z = points.T
    clouds.append(go.Scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, name=name, hoverinfo="skip"))
go.Figure(clouds, {"scene": {"aspectmode": "data"}, "margin": dict.fromkeys("lrtb", 0), "height": 500})

# %% [markdown]
# ## One voxel, explained
#
# `explain` carves once more and keeps an eye on one voxel: which pixels voted, what the test said, and what the
# hysteresis made of it. Here a candidate that its neighbours saved.

# %%
settings = recon3d.Settings(n_voxels=200_000, carving=recon3d.VoxelColoring())
saved = volume.centers(groups["candidate, kept"][0])
recon3d.explain(scene, settings, at=saved[len(saved) // 2])

# %% [markdown]
# And a click on the photograph: which voxel does this pixel show, and why was it kept?

# %%
recon3d.explain(scene, settings, pixel=(scene.views[0].name, 160, 120))
