"""A drive through one crossing, to be sent."""

from tests.live.conftest import config, crossing

__all__ = ["config", "crossing"]
