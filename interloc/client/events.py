"""Server-sent events, as far as the service sends them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from interloc.errors import NetworkError

_MAX_EVENT_BYTES = 4 * 1024**2


def read_events(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the data of each event of a stream that arrives in pieces, and nothing (``b""``) for a sign of life.

    An event cut off at the end is dropped.

    Raises
    ------
    NetworkError
        A stream without an end of event.
    """
    pending, data = b"", []
    for piece in pieces:
        *lines, pending = (pending + piece).replace(b"\r\n", b"\n").split(b"\n")
        for line in lines:
            name, _, value = line.partition(b":")
            if name == b"data":
                data.append(value.removeprefix(b" "))
            elif line.startswith(b":"):
                yield b""
            elif not line and data:
                yield b"\n".join(data)
                data = []
        if len(pending) + sum(map(len, data)) > _MAX_EVENT_BYTES:
            raise NetworkError("the server sent events without an end")
