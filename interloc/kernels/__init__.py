"""Compiled pixel and point loops; each has its plain twin in the tests."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")

_log = logging.getLogger(__name__)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel on its first call and keep the machine code on disk for the next process."""
    try:
        kernel = njit(cache=True, nogil=True)(function)
    except RuntimeError as error:  # numba found no folder to write to
        if "cannot cache" not in str(error):
            raise
        _log.warning(
            "compiled kernels cannot be kept on disk, so every start compiles them anew (about 20 s). "
            "Set NUMBA_CACHE_DIR to a folder that can be written."
        )
        kernel = njit(nogil=True)(function)
    return cast("Callable[P, R]", kernel)
