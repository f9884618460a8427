"""recon3d: coloured, measured 3D models from calibrated photographs.

Conventions, everywhere in the package:

World
    Right-handed, in world units; ``Scene.mm_per_unit`` says how many millimetres one is. Lengths are in world units
    unless their name ends in ``_mm``.
Camera
    OpenCV's axes: x right, y down, z forward. ``cam_from_world`` takes world points to camera points,
    P = K [R | t] takes them to pixels.
Pixels
    (u, v) is (column, row), and pixel centres are at integers: pixel (0, 0) spans -0.5 to 0.5. Images are indexed
    [row, column], uint8 RGB. Photographs and masks are set upright as their EXIF orientation says, and undistorted;
    K, width and height are those of the upright, undistorted picture.
Voxels
    Index (i, j, k) spans ``origin + size * (i, j, k)`` to ``origin + size * (i + 1, j + 1, k + 1)``, as in Open3D's
    ``VoxelGrid``.
Colours
    uint8 0 to 255 in images and voxels, floats 0 to 1 in Open3D's meshes and clouds.

The main job::

    import recon3d
    scene = recon3d.open_scene("templeSparseRing")
    result = recon3d.reconstruct(scene)
    print(recon3d.evaluate(result.mesh, recon3d.read_mesh("ground_truth.ply")).summary())
    recon3d.save(result, "out")
"""

import os
import pkgutil

import lazy_loader

# Threads that spin while they wait make short parallel loops ten times slower on a busy machine.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# The names and where they live are in __init__.pyi; each is imported on its first use, since Open3D takes seconds.
__getattr__, __dir__, _lazy = lazy_loader.attach_stub(__name__, __file__)
# The packages are reached by their names, but `from recon3d import *` leaves the user's own `io` alone.
__all__ = sorted(set(_lazy) - {module.name for module in pkgutil.iter_modules(__path__)})
