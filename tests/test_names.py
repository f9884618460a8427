"""Public names, and what hides what."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

import pytest

import recon3d

PACKAGES = ["recon3d", *(m.name for m in pkgutil.walk_packages(recon3d.__path__, "recon3d.") if m.ispkg)]
MODULES = [
    m.name
    for m in pkgutil.walk_packages(recon3d.__path__, "recon3d.")
    # Kernels are reached through their modules alone.
    if not m.name.endswith("__main__") and not m.name.startswith("recon3d.kernels.")
]


@pytest.mark.parametrize("package", PACKAGES)
def test_no_name_of_a_package_hides_one_of_its_modules(package: str) -> None:
    found = importlib.import_module(package)
    inside = {m.name for m in pkgutil.iter_modules(found.__path__)}
    hidden = [name for name in inside if not isinstance(getattr(found, name, found), ModuleType)]
    assert not hidden, f"{package}: {', '.join(hidden)} is a module and something else"
    assert not inside & set(getattr(found, "__all__", ()))


@pytest.mark.parametrize("module", MODULES)
def test_no_function_or_class_bears_its_modules_name(module: str) -> None:
    name = module.rpartition(".")[2]
    assert isinstance(getattr(importlib.import_module(module), name, recon3d), ModuleType)
