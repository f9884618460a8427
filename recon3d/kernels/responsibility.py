"""Which voxels on a pixel's ray are responsible for its colour."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import Part, kernel, span
from recon3d.kernels.rays import walk

_OPAQUE = 1e-4  # what is seen with less than this is not seen


@kernel(parallel=True)
def respond(
    part: Part,
    voxels: NDArray[np.int64],
    centers: NDArray[np.float64],
    observed: NDArray[np.uint8],
    seen: NDArray[np.bool_],
    opacity: NDArray[np.float32],
    colors: NDArray[np.float32],
    sigma: float,
    unexplained: float,
    new_opacity: NDArray[np.float32],
    new_colors: NDArray[np.float32],
    visible: NDArray[np.float32],
) -> None:
    """New opacity (n,) and colour (n, 3) of every voxel, and the light that reaches it in each view (n, n_views)."""
    path = np.empty(sum(opacity.shape), np.int64)
    for n in span(part, voxels.shape[0]):
        i, j, k = voxels[n, 0], voxels[n, 1], voxels[n, 2]
        total = reaching = red = green = blue = 0.0
        for view in range(centers.shape[0]):
            visible[n, view] = 0.0
            if not seen[n, view]:
                continue
            length = walk(centers[view], i, j, k, opacity.shape, True, path)
            own, onward, visible[n, view] = _shares(
                opacity, colors, path[:length], voxels[n], observed[n, view], sigma, unexplained
            )
            total += own
            reaching += onward
            red += own * observed[n, view, 0]
            green += own * observed[n, view, 1]
            blue += own * observed[n, view, 2]
        # Without a responsibility to speak of nothing is learned.
        new_opacity[n] = total / reaching if reaching > _OPAQUE else opacity[i, j, k]
        if total > _OPAQUE:
            new_colors[n, 0] = red / total
            new_colors[n, 1] = green / total
            new_colors[n, 2] = blue / total
        else:
            new_colors[n] = colors[i, j, k]


@kernel()
def _shares(
    opacity: NDArray[np.float32],
    colors: NDArray[np.float32],
    path: NDArray[np.int64],
    voxel: NDArray[np.int64],
    observed: NDArray[np.uint8],
    sigma: float,
    unexplained: float,
) -> Any:
    """Probabilities that a ray's colour comes from a voxel on it, and from it or behind; and the light left there."""
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
