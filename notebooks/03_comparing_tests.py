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
# # Comparing photo-consistency tests
#
# Which test decides best whether the photographs agree on a voxel? Here several judge the same voxels of the built-in
# little temple, from the same views. For your own photographs replace the first call by `recon3d.open_scene(folder)`,
# and leave out `ground_truth` where there is none.

# %%
# %matplotlib inline
import numpy as np

import recon3d

built_in = recon3d.little_temple(width=320, height=240)
scene = built_in.scene
same_for_all = {
    "settings": recon3d.Settings(n_voxels=100_000, max_views=8, carving=recon3d.VoxelColoring()),
    "ground_truth": built_in.ground_truth,
    "completeness_threshold_mm": 2.5,  # about a voxel
    "spacing": 1e-3,  # of the samples that are measured, world units: quick rather than fine
}

# %% [markdown]
# ## A handful of tests
#
# Every fourth view is held out: how well the coloured result predicts it is the re-projection error. That
# needs no ground truth. An error counts only where there is something to see, so read it with the overlap.

# %%
comparison = recon3d.compare(scene, ["fuzzy", "adaptive", "color-caching", "ncc"], **same_for_all)
comparison

# %% [markdown]
# ## One test, many thresholds
#
# A single threshold on the fuzzy membership trades what is found against what is right. Too low, and voxels before the
# surface are accepted, which then hide it: both suffer. Too high, and the surface is carved. The paper sets two
# thresholds by the number of views instead; its test is run once beside the sweep.

# %%
swept = recon3d.compare(
    scene, ["fuzzy-single", "fuzzy"], sweep=("threshold", np.arange(0.3, 0.85, 0.1).round(1)), **same_for_all
)
swept.plot()

# %% [markdown]
# ## A test of your own
#
# Any function of the patches will do. This one asks whether all pixels have about the same hue, be they bright or
# dark. What it takes beside the patches can be swept like any other parameter.


# %%
def same_hue(patches: recon3d.Patches, limit: float = 0.01) -> recon3d.Verdict:
    """How far red's and green's shares of the light spread over a voxel's pixels."""
    voxel, n = patches.voxel_of_pixel, patches.n_voxels
    share = (patches.colors[:, :2] + 1.0) / (patches.colors.sum(axis=1, keepdims=True) + 3.0)
    count = np.bincount(voxel, minlength=n)
    mean = np.stack([np.bincount(voxel, share[:, c], n) for c in (0, 1)], axis=1) / count[:, None]
    scatter = np.bincount(voxel, ((share - mean[voxel]) ** 2).sum(axis=1), n) / count
    half = np.full(n, 0.5)
    return recon3d.Verdict(limit / (limit + np.sqrt(scatter)), low=half, high=half)


own = recon3d.compare(scene, [same_hue, "fuzzy"], sweep=("limit", (0.005, 0.01, 0.02)), **same_for_all)
own

# %%
own.plot()

# %% [markdown]
# The mesh of any of them, with the same settings and all views:

# %%
result = recon3d.reconstruct(
    scene, recon3d.Settings(n_voxels=100_000, max_views=8, carving=recon3d.VoxelColoring(test=same_hue))
)
recon3d.show_mesh(result.mesh)

# %% [markdown]
# On the command line: `recon3d compare SCENE --tests fuzzy,my_module:same_hue --sweep limit=0.005:0.02:0.005`. There,
# and here with `folder=...`, tests that are finished are not run again.
