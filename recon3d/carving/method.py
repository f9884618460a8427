"""What all carving methods have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, get_args

from recon3d.carving.hysteresis import Connectivity
from recon3d.carving.observer import Observer
from recon3d.checks import require_choice
from recon3d.consistency.base import ConsistencyTest, require_test
from recon3d.consistency.fuzzy import FuzzyAdaptiveHysteresis
from recon3d.scene.scene import Scene
from recon3d.tasks import Progress
from recon3d.volume.carved import Carved
from recon3d.volume.dense import CarvingVolume
from recon3d.volume.lattice import Lattice


@dataclass(frozen=True)
class Method(ABC):
    """A carving algorithm with its options as fields."""

    needs_silhouettes: ClassVar[bool] = False
    """Whether some view must have a silhouette."""
    one_sided: ClassVar[bool] = False
    """Whether the views must satisfy the ordinal visibility constraint."""
    uses_test: ClassVar[bool] = False
    """Whether a photo-consistency test decides, as in every ``JudgingMethod``."""

    @abstractmethod
    def carve(
        self,
        scene: Scene,
        volume: CarvingVolume | Lattice,
        *,
        progress: Progress | None = None,
        observer: Observer | None = None,
    ) -> Carved:
        """Carve a volume, of which only the occupied voxels are visited, or a lattice that is full at first.

        Parameters
        ----------
        progress : called with the number of steps done and of all.
        observer : receives the test's verdicts as they are made; without a test there are none.
        """

    def dense(self) -> Method:
        """The method that leaves the same voxels with all of them stored."""
        return self


@dataclass(frozen=True)
class JudgingMethod(Method):
    """A method in which a photo-consistency test decides, with hysteresis where the test has two thresholds."""

    uses_test: ClassVar[bool] = True

    test: ConsistencyTest = field(default_factory=FuzzyAdaptiveHysteresis)
    """The photo-consistency test; the paper's fuzzy test by default."""
    connectivity: Connectivity = 26
    """Neighbours that carry a candidate: 6 (faces), 18 (edges), 26 (corners)."""

    def __post_init__(self) -> None:
        require_test(self.test)
        require_choice("connectivity", self.connectivity, get_args(Connectivity))
