"""Calls made once anything imports a package, so that registering with it does not import it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any


def after_import(name: str, call: Callable[[ModuleType], None]) -> None:
    """Calls a function with a module, at once if the module is imported, or else as soon as it is."""
    if name in sys.modules:
        call(sys.modules[name])
    else:
        sys.meta_path.insert(0, _AfterImport(name, call))


class _AfterImport(MetaPathFinder):
    """Finds one module where Python would, and calls a function with it once it has run."""

    def __init__(self, name: str, call: Callable[[ModuleType], None]):
        self._name, self._call = name, call

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self._name:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        loader: Any = spec and spec.loader
        if loader:
            run = loader.exec_module

            def run_and_call(module: ModuleType) -> None:
                run(module)
                self._call(module)

            loader.exec_module = run_and_call
        return spec
