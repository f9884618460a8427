"""Which voxels on a pixel's ray are responsible for its colour."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.rays import walk
from recon3d.kernels.types import Observed

_OPAQUE = 1e-4  # what is seen with less than this is not seen


class Matter(NamedTuple):
    """How opaque voxels are, and their colours; one row a voxel, or on the lattice."""

    opacity: NDArray[np.float32]
    """(n,) or (nx, ny, nz) in [0, 1]."""
    colors: NDArray[np.float32]
    """(n, 3) or (nx, ny, nz, 3) RGB, grey levels."""


class PixelModel(NamedTuple):
    """How pixels come by their colours."""

    sigma: float
    """Standard deviation of a pixel about the colour of its voxel, grey levels."""
    unexplained: float
    """Density of colours that no voxel explains, relative to the height of that of a voxel's."""


@kernel(parallel=True)
def respond(
    part: Part,
    observed: Observed,
    centers: NDArray[np.float64],
    matter: Matter,
    model: PixelModel,
    new: Matter,
    visible: NDArray[np.float32],
) -> None:
    """New opacity and colour of every voxel (n,), and the light that reaches it in each view (n, n_views)."""
    voxels, shown, seen = observed
    opacity, colors = matter
    path = np.empty(sum(opacity.shape), np.int64)
    for n in span(part, voxels.shape[0]):
        i, j, k = voxels[n, 0], voxels[n, 1], voxels[n, 2]
        total = reaching = red = green = blue = 0.0
        for view in range(centers.shape[0]):
            visible[n, view] = 0.0
            if not seen[n, view]:
                continue
            length = walk(centers[view], voxels[n], opacity.shape, True, path)
            own, onward, visible[n, view] = _shares(matter, path[:length], voxels[n], shown[n, view], model)
            total += own
            reaching += onward
            red += own * shown[n, view, 0]
            green += own * shown[n, view, 1]
            blue += own * shown[n, view, 2]
        # Without a responsibility to speak of nothing is learned.
        new.opacity[n] = total / reaching if reaching > _OPAQUE else opacity[i, j, k]
        if total > _OPAQUE:
            new.colors[n, 0] = red / total
            new.colors[n, 1] = green / total
            new.colors[n, 2] = blue / total
        else:
            new.colors[n] = colors[i, j, k]


@kernel()
def _shares(
    matter: Matter,
    path: NDArray[np.int64],
    voxel: NDArray[np.int64],
    observed: NDArray[np.uint8],
    model: PixelModel,
) -> Any:
    """Probabilities that a ray's colour comes from a voxel on it, and from it or behind; and the light left there."""
    opacity, colors = matter
    sigma, unexplained = model
    target = (voxel[0] * opacity.shape[1] + voxel[1]) * opacity.shape[2] + voxel[2]
    alphas, paint = opacity.reshape(-1), colors.reshape(-1, 3)
    through = 1.0
    before = own = behind = arriving = 0.0
    met = False
    for at in path:
        if at == target:
            met = True
            arriving = through
        if alphas[at] <= 0.0:
            continue
        red, green, blue = paint[at, 0] - observed[0], paint[at, 1] - observed[1], paint[at, 2] - observed[2]
        squared = red * red + green * green + blue * blue
        # Farther off the exponential is below 1e-9, and not worth its time.
        agreement = np.exp(-0.5 * squared / (sigma * sigma)) if squared < 40.0 * sigma * sigma else 0.0
        share = through * alphas[at] * agreement
        if at == target:
            own = share
        elif met:
            behind += share
        else:
            before += share
        through *= 1.0 - alphas[at]
        if through < _OPAQUE:
            break
    if not met:
        return 0.0, 0.0, 0.0
    behind += through * unexplained
    whole = before + own + behind
    if whole <= 0.0:
        return 0.0, 0.0, arriving
    return own / whole, (own + behind) / whole, arriving
