"""What to do with a scene: every choice of the main job in one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from inspect import Parameter, signature
from typing import Any, Literal, get_args

import numpy as np

from recon3d.carving import METHODS
from recon3d.carving.visibility import largest_admissible_views, spread_views
from recon3d.consistency.base import ConsistencyTest
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis
from recon3d.consistency.spec import _record_of, _restored
from recon3d.scene.scene import Scene
from recon3d.surface.poisson import Surface

_CALLBACKS = ("progress", "observer")  # keywords of methods that are no options


_ACCEPTED = {int: (int, np.integer), float: (int, float, np.integer, np.floating), str: (str,)}


@dataclass(frozen=True)
class Settings:
    """What to do with a scene.

    The paper's own method is ``method="voxel-coloring"``: the fuzzy test, at a million voxels, of eight views
    (``max_views=8``).
    """

    n_voxels: int | None = 1_000_000
    """Approximate number of voxels in the bounds; None when ``voxel_size`` is given."""
    voxel_size: float | None = None
    """Edge length in world units, instead of ``n_voxels``."""
    method: str = "auto"
    """One of ``METHODS``, or "auto": generalised voxel colouring where a test is given or no silhouettes are known,
    else vote carving."""
    method_options: Mapping[str, Any] = field(default_factory=dict)
    """Keywords of the method, such as ``connectivity`` and ``layering`` of ``voxel_coloring``."""
    test: ConsistencyTest | None = None
    """Any photo-consistency test, for a method that uses one; the paper's fuzzy test when None."""
    views: Literal["auto", "all"] | tuple[str, ...] = "auto"
    """"auto": all, or the largest subset that a one-sided method admits; "all"; or names, with wildcards."""
    max_views: int | None = None
    """With "auto": use at most so many, those farthest apart; the paper uses 8."""
    fill_hidden: bool = False
    """With a one-sided method, mesh what lies hidden behind the accepted voxels, too: solid, but partly guessed."""
    quality: Literal["auto", "voxels", "dense"] = "auto"
    """"voxels": the mesh of the voxels; "dense": of the points that dense matching finds inside them; "auto": sharp
    where the method is left to choose and silhouettes are known."""
    surface: Surface = "poisson"
    """How a sharp mesh is made of its points."""
    keep_unsupported: bool = True
    """Keep surface that nothing was measured of, such as the underside that no view sees, so that the mesh is closed:
    the hull's. A carved surface is supported where a view sees it, a sharp one where two views found it."""
    smoothing: int = 5
    """Pairs of Taubin steps on a carved mesh; 0: none."""
    min_component: float = 100.0
    """Area, in faces of a voxel, below which a separate piece of the mesh is a speck and dropped; 100 is the surface
    of four voxels cubed, 0 keeps all."""

    def __post_init__(self) -> None:
        if self.voxel_size is not None and not 0 < self.voxel_size < np.inf:
            raise ValueError(f"expected a positive voxel size, got {self.voxel_size}")
        if self.voxel_size is not None:
            object.__setattr__(self, "n_voxels", None)
        if self.method != "auto" and self.method not in METHODS:
            raise ValueError(f"expected method auto, {', '.join(METHODS)}, got {self.method!r}")
        if isinstance(self.views, str) and self.views not in ("auto", "all"):
            raise ValueError(f"expected views 'auto', 'all' or a tuple of names, got {self.views!r}")
        for name, known in (("quality", ("auto", "voxels", "dense")), ("surface", get_args(Surface))):
            if getattr(self, name) not in known:
                raise ValueError(f"expected {name} {', '.join(known)}, got {getattr(self, name)!r}")
        if self.max_views is not None and self.max_views < 1:
            raise ValueError(f"expected max_views of at least 1, got {self.max_views}")
        if self.smoothing < 0:
            raise ValueError(f"expected smoothing of 0 or more, got {self.smoothing}")
        if not 0 <= self.min_component < np.inf:
            raise ValueError(f"expected min_component of 0 or more, got {self.min_component}")

    def resolved(self, scene: Scene) -> Settings:
        """The same settings with the method, quality and test that "auto" and None mean for a scene.

        Raises
        ------
        ValueError : the method has no such option, or uses no test.
        """
        method = self.method
        if method == "auto":
            known = any(view.has_silhouette for view in scene.views)
            method = "vote-carving" if known and self.test is None else "generalized-voxel-coloring"
        quality = self.quality
        if quality == "auto":
            quality = "dense" if self.method == "auto" and method == "vote-carving" else "voxels"
        kind = METHODS[method]
        if self.test is not None and not kind.uses_test:
            raise ValueError(f"{method} uses no photo-consistency test, got {self.test!r}")
        parameters = signature(kind.carve).parameters.values()
        options = [p.name for p in parameters if p.kind is Parameter.KEYWORD_ONLY and p.name not in _CALLBACKS]
        unknown = [name for name in self.method_options if name not in options]
        if unknown:
            raise ValueError(f"{method} has no option {', '.join(unknown)}; it has {', '.join(options)}")
        for parameter in parameters:
            value, kinds = self.method_options.get(parameter.name), _ACCEPTED.get(type(parameter.default))
            if value is not None and kinds and (isinstance(value, bool) or not isinstance(value, kinds)):
                expected = type(parameter.default).__name__
                raise ValueError(
                    f"{method} option {parameter.name}: expected a value of type {expected}, got {value!r}"
                )
        test = self.test or (FuzzyAdaptiveHysteresis() if kind.uses_test else None)
        return replace(self, method=method, quality=quality, test=test)

    def record(self) -> dict[str, Any]:
        """Every setting, for a JSON file; a test as its class, or module:name if it is a user's, and its parameters."""
        plain = {name: value for name, value in vars(self).items() if name != "test"}
        test = _record_of(self.test) if self.test else None
        return {**plain, "method_options": dict(self.method_options), "test": test}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Settings:
        """The settings of a record that was read from a JSON file.

        Raises
        ------
        ValueError : a setting is not known or has no possible value.
        DataError : the test cannot be made again: an object of a user's own that was given from Python.
        """
        unknown = set(record) - {parameter.name for parameter in fields(cls)}
        if unknown:
            raise ValueError(f"unknown settings {', '.join(sorted(unknown))}")
        values: dict[str, Any] = {name: _restored(value) for name, value in record.items()}
        return cls(**values)


def choose_views(scene: Scene, settings: Settings) -> Scene:
    """The scene with the views that the settings ask for."""
    if settings.views == "all":
        return scene
    if settings.views != "auto":
        return scene.subset(settings.views)
    one_sided = METHODS[settings.method].one_sided
    names = largest_admissible_views(scene) if one_sided else [view.name for view in scene.views]
    return spread_views(scene.subset(names), settings.max_views or len(names))
