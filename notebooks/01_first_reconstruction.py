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
# # A first reconstruction
#
# From sixteen calibrated photographs to a coloured mesh, its error against the exact surface, and pictures of it,
# with the built-in little temple. For your own photographs replace the first call by `recon3d.open_scene(folder)`.

# %%
# %matplotlib inline
import matplotlib.pyplot as plt

import recon3d

built_in = recon3d.little_temple(width=480, height=360)
scene = built_in.scene
scene

# %% [markdown]
# ## Carve
#
# A volume of voxels encloses the scene's bounds. Voxel colouring visits it layer by layer, from the cameras inwards.
# A voxel stays when the pixels that show it agree; the default test is the paper's fuzzy membership with two
# thresholds that adapt to the number of views.

# %%
volume = recon3d.CarvingVolume.enclosing(scene.bounds, n_voxels=500_000)
hull = recon3d.VoxelColoring(recon3d.FuzzyAdaptiveHysteresis()).carve(scene, volume)
hull

# %% [markdown]
# What the test said of every voxel is kept: here the degree of photo-consistency in a slice through the columns.

# %%
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
level = int(hull.degree.shape[2] * 0.45)
image = axes[0].imshow(hull.degree[:, :, level].T, origin="lower", vmin=0, vmax=1)
axes[0].set_title("degree of photo-consistency; white: not asked")
figure.colorbar(image)
axes[1].imshow(hull.labels[:, :, level].T, origin="lower", cmap="tab10", vmin=0, vmax=9)
axes[1].set_title(", ".join(f"{label.value} {label.name.lower()}" for label in recon3d.Label), fontsize=8)
plt.show()

# %% [markdown]
# ## Mesh
#
# The accepted voxels become a closed, smooth, coloured mesh. Turn it with the mouse.

# %%
mesh = recon3d.surface.mesh_volume(hull.volume)
recon3d.show_mesh(mesh)

# %% [markdown]
# ## Measure
#
# Accuracy: the distance within which 90% of the reconstruction lies from the true surface. Completeness: the share of
# the true surface within 1.25 mm of the reconstruction.

# %%
evaluation = recon3d.evaluate(mesh, built_in.ground_truth, mm_per_unit=scene.mm_per_unit)
evaluation

# %%
recon3d.reporting.plot_evaluation(evaluation, "little temple")

# %% [markdown]
# ## Render
#
# Photograph, colours, shading, normals and depth from the input cameras, then a turn around the object.

# %%
renderer = recon3d.rendering.Renderer(mesh)
plt.figure(figsize=(14, 6))
plt.imshow(recon3d.rendering.comparison_sheet(scene, renderer, views=3))
plt.axis("off")
plt.show()

# %%
plt.figure(figsize=(14, 2.5))
plt.imshow(recon3d.rendering.turntable(scene, renderer, frames=6, size=240))
plt.axis("off")
plt.show()

# %% [markdown]
# ## All at once
#
# `reconstruct` does these steps with one call, and `save` writes mesh, points, voxels, pictures and a record of every
# parameter and figure. Left to choose for itself, it takes a method that matches neighbouring views inside the visual
# hull.

# %%
settings = recon3d.Settings(n_voxels=500_000)
result = recon3d.reconstruct(scene, settings, ground_truth=built_in.ground_truth)
result
