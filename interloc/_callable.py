"""Packages that can be called: `interloc.detect(drive)` and `from interloc.detect.detector import Detector` both work.

A package `interloc.detect` and a function of that name cannot both be the attribute `detect` of `interloc`: which one
wins would depend on what was imported first. So the package itself passes a call on to the function.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


def make_callable(package: str, module: str, function: str) -> None:
    """Make a call of ``package`` a call of a function, imported on the first one."""

    class CallablePackage(ModuleType):
        def __call__(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - passed on
            return getattr(import_module(module), function)(*args, **kwargs)

    sys.modules[package].__class__ = CallablePackage
