"""small_gicp is an extra."""

from __future__ import annotations

import pytest

pytest.importorskip("small_gicp", reason="poses from points need small_gicp")
