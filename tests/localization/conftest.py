"""The made-up town, once for all tests."""

import pytest

from interloc.osm.graph import RoadGraph
from tests.localization.town import town_graph


@pytest.fixture(scope="session")
def town() -> RoadGraph:
    return town_graph()
