"""A drive through one crossing, to be sent."""

from __future__ import annotations

from tests.live.conftest import config, crossing

__all__ = ["config", "crossing"]
