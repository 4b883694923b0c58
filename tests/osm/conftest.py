"""Small maps written by hand."""

import pytest

NODES = """
  <node id="1" lat="49.000" lon="8.400"/>
  <node id="2" lat="49.001" lon="8.400"/>
  <node id="3" lat="49.002" lon="8.400"/>
  <node id="4" lat="49.001" lon="8.399"/>
  <node id="5" lat="49.001" lon="8.401"/>
  <node id="9" lat="49.009" lon="8.409"/>
"""

WAYS = """
  <way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="residential"/><tag k="name" v="Weg"/></way>
  <way id="11"><nd ref="4"/><nd ref="2"/><nd ref="5"/><tag k="highway" v="tertiary"/><tag k="ref" v="K 1"/></way>
  <way id="12"><nd ref="1"/><nd ref="9"/><tag k="building" v="yes"/></way>
"""


def document(body: str, *, head: str = "") -> str:
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{head}<osm version="0.6" generator="hand">\n{body}</osm>\n'


@pytest.fixture(scope="session")
def crossing() -> str:
    """A crossing of two streets at node 2, and a house."""
    return document(NODES + WAYS)
