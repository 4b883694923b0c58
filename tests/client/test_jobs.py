"""Server-sent events, however the network cuts them."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.client.jobs import read_events
from interloc.errors import NetworkError

STREAM = (
    'id: 1\nevent: job\ndata: {"name": "Straße\u2028am Ort"}\n\n: still here\n\ndata: a\r\ndata: b\r\n\r\ndata:cut'
).encode()
EVENTS = ['{"name": "Straße\u2028am Ort"}'.encode(), b"", b"a\nb"]


@given(st.lists(st.integers(0, len(STREAM)), max_size=20))
def test_any_pieces_give_the_same_events(cuts: list[int]) -> None:
    pieces = [STREAM[start:end] for start, end in pairwise([0, *sorted(cuts), len(STREAM)])]
    assert list(read_events(pieces)) == EVENTS


def test_an_event_without_end_is_not_kept_in_memory() -> None:
    with pytest.raises(NetworkError, match="without an end"):
        list(read_events([b"data: ", *[b"x" * 1_000_000] * 8]))
