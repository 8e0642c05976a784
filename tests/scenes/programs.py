"""Load a program of the clone that is in no package as a module."""

from __future__ import annotations

import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

from small_demo import ROOT


def program(place: str) -> ModuleType:
    """Return the module of a file, as "scripts/docs", without leaving its bytecode beside it."""
    loader = SourceFileLoader(Path(place).stem.replace("-", "_"), str(ROOT / place))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module
