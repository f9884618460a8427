from __future__ import annotations

import sys
from contextlib import suppress

import numpy as np
import pytest

from recon3d.study.memory import peak_memory


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's high-water mark is Linux's")
def test_the_peak_counts_what_is_freed_again_and_starts_anew() -> None:
    for mib in (80, 40):
        with peak_memory() as peak:
            work = np.ones(mib * 2**17)
            del work
        assert peak.mib == pytest.approx(mib, abs=10)
    with suppress(KeyError), peak_memory() as peak:
        {}[np.ones(40 * 2**17).sum()]
    assert peak.mib == pytest.approx(40, abs=10)


def test_where_the_system_cannot_say_the_peak_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    with peak_memory() as peak:
        pass
    assert peak.mib is None
