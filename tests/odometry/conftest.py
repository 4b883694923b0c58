"""small_gicp is an extra."""

import pytest

pytest.importorskip("small_gicp", reason="poses from points need small_gicp")
