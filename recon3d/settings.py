"""What to do with a scene: every choice of the main job in one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np

from recon3d.carving import METHODS, N_VOXELS, JudgingMethod, Method, VoteCarving, suitable_method
from recon3d.carving.start import any_silhouette
from recon3d.carving.visibility import largest_admissible_views, spread_views
from recon3d.checks import require_number, require_whole
from recon3d.consistency.spec import is_built_in, record_of, restore
from recon3d.errors import ArgumentError, DataError, SceneError
from recon3d.scene.camera import Camera
from recon3d.scene.scene import Scene
from recon3d.scene.view import View
from recon3d.stereo.patch_match import Matching
from recon3d.stereo.refinement import PASSES
from recon3d.surface.meshing import Meshing
from recon3d.volume.lattice import Lattice


@dataclass(frozen=True)
class Settings:
    """What to do with a scene.

    The paper's own method is ``carving=VoxelColoring()``: the fuzzy test, at a million voxels, of eight views
    (``max_views=8``). ``dataclasses.replace`` changes single choices; the default for ``None`` and "auto" depends on
    the scene, see ``resolved``.
    """

    views: Literal["auto", "all"] | tuple[str, ...] = "auto"
    """"auto": all, or the largest subset that a one-sided method admits; "all"; or names, with wildcards."""
    max_views: int | None = None
    """With "auto": use at most so many, those farthest apart; the paper uses 8."""
    n_voxels: int | None = None
    """Approximate number of voxels in the bounds; a million when neither this nor ``voxel_size`` is given."""
    voxel_size: float | None = None
    """Edge length in world units, instead of ``n_voxels``."""
    carving: Method | None = None
    """One of ``METHODS`` with its options; None: vote carving, or generalised voxel colouring where neither silhouettes
    are known nor views can be matched."""
    matching: Literal["auto"] | tuple[Matching, ...] | None = "auto"
    """Passes of dense matching inside the carved volume; None: the mesh is that of the voxels; "auto": ``PASSES`` where
    carving is left to choose and chooses vote carving, else none."""
    meshing: Meshing = field(default_factory=Meshing)
    """How the mesh is made."""

    def __post_init__(self) -> None:
        self._check_views()
        if self.n_voxels is not None:
            require_whole("n_voxels", self.n_voxels)
        if self.voxel_size is not None:
            require_number("voxel_size", self.voxel_size, "(0, inf)")
        if self.n_voxels is not None and self.voxel_size is not None:
            raise ArgumentError(f"expected n_voxels or voxel_size, got both: {self.n_voxels} and {self.voxel_size}")
        if self.carving is not None and type(self.carving) not in METHODS.values():
            names = ", ".join(method.__name__ for method in METHODS.values())
            raise ArgumentError(f"expected carving by one of {names}, got {self.carving!r}")
        self._check_matching()
        self._check_meshing()

    def _check_views(self) -> None:
        """Refuse what names no views, and a limit on views that are all named."""
        if self.views not in ("auto", "all"):
            if not _holds(self.views, str) or not self.views:
                raise ArgumentError(f"expected views 'auto', 'all' or a tuple of names, got {self.views!r}")
            object.__setattr__(self, "views", tuple(self.views))
        if self.max_views is not None:
            require_whole("max_views", self.max_views)
            if self.views != "auto":
                raise ArgumentError(f"expected views 'auto' with max_views={self.max_views}, got {self.views!r}")

    def _check_matching(self) -> None:
        """Refuse what is no sequence of passes."""
        if self.matching is None or self.matching == "auto":
            return
        if not _holds(self.matching, Matching):
            raise ArgumentError(f"expected matching 'auto', None or a tuple of Matching, got {self.matching!r}")
        if not self.matching:
            raise ArgumentError("expected one or more passes of matching, or None for no matching, got ()")
        object.__setattr__(self, "matching", tuple(self.matching))

    def _check_meshing(self) -> None:
        """Refuse options of a mesh that is not made; where that depends on the scene, once it is known."""
        if not isinstance(self.meshing, Meshing):
            raise ArgumentError(f"expected meshing to be a Meshing, got {self.meshing!r}")
        if self.meshing.fill_hidden and (self.carving is None or not self.carving.one_sided):
            raise ArgumentError(
                "fill_hidden: expected a one-sided carving method such as VoxelColoring, whose accepted voxels are a "
                "shell; the mesh of every other is solid anyway"
            )
        voxels = self.matching is None or (self.matching == "auto" and self.carving is not None)
        if voxels and self.meshing.surface != "poisson":
            raise ArgumentError(
                f"surface={self.meshing.surface!r}: expected matching, since it is how a mesh is made of matched points"
            )
        if voxels:
            _refuse_uncertainty(self.meshing)
        for name, given in (
            ("fill_hidden", self.meshing.fill_hidden),
            ("smoothing", self.meshing.smoothing is not None),
        ):
            if given and isinstance(self.matching, tuple):
                raise ArgumentError(f"{name}: expected matching=None, since it is of the mesh of the voxels")

    def resolved(self, scene: Scene) -> Settings:
        """The same settings with what "auto" and None mean for a scene.

        Raises
        ------
        SceneError : the method needs silhouettes, and no view has one.
        ArgumentError : an option means nothing for this scene.
        """
        carving = self.method_for(scene)
        if carving.needs_silhouettes and not any_silhouette(scene):
            raise SceneError(f"scene {scene.name}: {method_name(carving)} needs silhouettes, and no view has one")
        passes, meshing = self.passes_for(scene), self.meshing
        if not passes:
            _refuse_uncertainty(meshing)
        if meshing.keep_unsupported is None:
            meshing = replace(meshing, keep_unsupported=not passes or any_silhouette(scene))
        return replace(self, carving=carving, matching=passes or None, meshing=meshing, n_voxels=self._n_voxels)

    def method_for(self, scene: Scene) -> Method:
        """The carving method that is chosen, or suits a scene."""
        return self.carving or suitable_method(scene)

    def passes_for(self, scene: Scene) -> tuple[Matching, ...]:
        """The passes of dense matching that are chosen, or suit a scene; empty: no matching."""
        if self.matching == "auto":
            return PASSES if self.carving is None and isinstance(self.method_for(scene), VoteCarving) else ()
        return self.matching or ()

    @property
    def _n_voxels(self) -> int | None:
        return N_VOXELS if self.n_voxels is None and self.voxel_size is None else self.n_voxels

    def lattice(self, scene: Scene) -> Lattice:
        """Where the voxels of a scene lie."""
        return Lattice.enclosing(scene.bounds, voxel_size=self.voxel_size, n_voxels=self._n_voxels)

    def record(self) -> dict[str, Any]:
        """Every setting, for a JSON file; a method or a test as its name and its options."""
        return {
            "views": self.views if isinstance(self.views, str) else list(self.views),
            "max_views": _plain(self.max_views),
            "n_voxels": _plain(self.n_voxels),
            "voxel_size": _plain(self.voxel_size),
            "carving": None if self.carving is None else _method_record(self.carving),
            "matching": [_plain_fields(each) for each in self.matching]
            if isinstance(self.matching, tuple)
            else self.matching,
            "meshing": _plain_fields(self.meshing),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any], *, test: str | None = None) -> Settings:
        """The settings of a record that was read from a JSON file, which may come from anyone: no code is run for it.

        Parameters
        ----------
        test : module:name of the user's own photo-consistency test that the record tells of; see ``load_test``.

        Raises
        ------
        ArgumentError : a setting is not known or has no possible value, or the recorded test is none of a user's own.
        DataError : it is no record, or the recorded test is a user's own and was not named.

        Warns
        -----
        UserWarning : the user's own test has another name than the recorded one.
        """
        if not isinstance(record, Mapping):
            raise DataError(f"expected settings by name, got {record!r}")
        unknown = set(record) - {setting.name for setting in fields(cls)}
        if unknown:
            raise ArgumentError(f"unknown settings {', '.join(sorted(unknown))}")
        values = dict(record)
        try:
            if values.get("carving") is not None:
                values["carving"] = _method_of(values["carving"], test)
            if isinstance(values.get("matching"), list):
                values["matching"] = tuple(Matching(**each) for each in values["matching"])
            if "meshing" in values:
                values["meshing"] = Meshing(**values["meshing"])
        except (TypeError, AttributeError) as error:  # options that are not there, or no options at all
            raise ArgumentError(str(error)) from None
        settings = cls(**values)
        used = isinstance(settings.carving, JudgingMethod) and not is_built_in(settings.carving.test)
        if test is not None and not used:
            raise ArgumentError(f"expected no test, since the record tells of none of a user's own, got {test}")
        return settings


def _refuse_uncertainty(meshing: Meshing) -> None:
    """Refuse a limit of what is known of matched points alone."""
    if meshing.max_uncertainty is not None:
        raise ArgumentError(
            f"max_uncertainty={meshing.max_uncertainty:g}: expected matching: the uncertainty of a mesh of voxels "
            "is not known"
        )


def _holds(value: object, kind: type) -> bool:
    """Whether a value is a tuple or list of one kind."""
    return isinstance(value, tuple | list) and all(isinstance(each, kind) for each in value)


def method_name(method: Method) -> str:
    """What a carving method is called in ``METHODS``."""
    return next((name for name, kind in METHODS.items() if kind is type(method)), type(method).__name__)


def _method_record(method: Method) -> dict[str, Any]:
    """Name and options of a carving method."""
    options = {option.name: getattr(method, option.name) for option in fields(method)}
    told = {name: record_of(value) if callable(value) else _plain(value) for name, value in options.items()}
    return {"name": method_name(method), "options": told}


def _method_of(record: Mapping[str, Any], test: str | None) -> Method:
    """The carving method that a record tells of."""
    name, given = record.get("name"), record.get("options", {})
    if not isinstance(name, str) or name not in METHODS:
        raise DataError(f"expected a carving method among {', '.join(METHODS)}, got {name!r}")
    if not isinstance(given, Mapping):
        raise DataError(f"expected the options of {name} by name, got {given!r}")
    options = dict(given)
    if "test" in options:
        options["test"] = restore(options["test"], test)
    return METHODS[name](**options)


def _plain_fields(value: Any) -> dict[str, Any]:
    """The fields of a value as JSON takes them."""
    return {name: _plain(each) for name, each in asdict(value).items()}


def _plain(value: Any) -> Any:
    """A number as Python's own."""
    return value.item() if isinstance(value, np.generic) else value


def choose_views(scene: Scene, settings: Settings) -> Scene:
    """The scene with the views that the settings ask for, each once: a duplicate would only confirm its original."""
    scene = _without_duplicates(scene if isinstance(settings.views, str) else scene.subset(settings.views))
    if settings.views != "auto":
        return scene
    one_sided = settings.carving is not None and settings.carving.one_sided
    names = largest_admissible_views(scene) if one_sided else [view.name for view in scene.views]
    return spread_views(scene.subset(names), settings.max_views or len(names))


def _without_duplicates(scene: Scene) -> Scene:
    """The scene without views whose camera, photograph and mask are those of an earlier one."""
    kept: dict[Camera, list[View]] = {}
    unique = []
    for view in scene.views:
        same = kept.setdefault(view.calibration, [])
        if not any(replace(view, name=other.name).fingerprint() == other.fingerprint() for other in same):
            same.append(view)
            unique.append(view)
    return scene if len(unique) == len(scene.views) else replace(scene, views=tuple(unique))
