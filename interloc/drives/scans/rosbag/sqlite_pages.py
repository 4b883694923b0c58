"""Rows of an SQLite database of which some pages are known: for whoever has the file elsewhere.

Tables are trees of pages ("B-tree pages" and "record format" of https://www.sqlite.org/fileformat2.html); `sqlite3`
itself opens whole files only. Row ids in place of integer keys are given; of long values, the beginning.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

_HEADER_BYTES = 100
_TREE, _LEAF = 5, 13  # kinds of pages of tables
_AT_ONCE = 1 << 18  # bytes: pages that follow each other are read together
_VALUE_BYTES = 4096
_MAX_DEPTH = 20
_MAX_PAGES = 10_000  # of trees that are walked: pages that name each other would not end

Value = int | float | str | bytes | None


class Pages:
    """A database of SQLite.

    Parameters
    ----------
    read
        From the first byte and the number of bytes to these.
    size
        Of the file, bytes.

    Raises
    ------
    ValueError, struct.error, LookupError
        Here and below: it is damaged.
    """

    def __init__(self, read: Callable[[int, int], bytes], size: int) -> None:
        self._read, self._size, self._walked = read, size, 0
        head = self._bytes(0, _HEADER_BYTES)
        (page,) = struct.unpack_from(">H", head, 16)
        self._page = 65_536 if page == 1 else page
        self._usable = self._page - head[20]
        if self._usable < 480:
            raise ValueError("pages of that size do not exist")

    def rows(self, root: int, depth: int = 0) -> Iterator[list[Value]]:
        """Yield the rows of the table whose tree begins at a page, in their order."""
        page = self._bytes((root - 1) * self._page, self._page)
        at = _HEADER_BYTES if root == 1 else 0
        kind, count = page[at], struct.unpack_from(">H", page, at + 3)[0]
        self._walked += 1
        if kind not in {_TREE, _LEAF} or depth > _MAX_DEPTH or self._walked > _MAX_PAGES:
            raise ValueError("no page of a table")
        cells = struct.unpack_from(f">{count}H", page, at + (12 if kind == _TREE else 8))
        if kind == _LEAF:
            for cell in cells:
                yield self._row(page, cell)
            return
        for place in (*cells, at + 8):  # the last child is named in the head
            (child,) = struct.unpack_from(">I", page, place)
            yield from self.rows(child, depth + 1)

    def _row(self, page: bytes, at: int) -> list[Value]:
        size, at = _varint(page, at)
        key, at = _varint(page, at)
        here = size
        if size > self._usable - 35:
            least = (self._usable - 12) * 32 // 255 - 23
            here = least + (size - least) % (self._usable - 4)
            here = here if here <= self._usable - 35 else least
        record = page[at : at + here]
        if here < size:  # the rest is in a chain of pages; one of them is enough
            (more,) = struct.unpack_from(">I", page, at + here)
            record += self._bytes((more - 1) * self._page, self._page)[4 : self._usable]
        return list(_values(record, key))

    def _bytes(self, start: int, count: int) -> bytes:
        """Read bytes, together with those around them."""
        first = start // _AT_ONCE * _AT_ONCE
        data = self._read(first, min(_AT_ONCE, self._size - first))
        found = data[start - first : start - first + count]
        if len(found) < count:
            raise ValueError("the file ends within a page")
        return found


def _values(record: bytes, key: int) -> Iterator[Value]:
    end, at = _varint(record, 0)
    kinds = []
    while at < end:
        kind, at = _varint(record, at)
        kinds.append(kind)
    for column, kind in enumerate(kinds):
        size = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)[kind] if kind < 10 else (kind - 12) // 2
        data = record[at : at + min(size, _VALUE_BYTES)]
        at += size
        if kind == 0:
            yield key if column == 0 else None  # the key of the table is kept as the row id alone
        elif kind < 7:
            yield int.from_bytes(data, "big", signed=True)
        elif kind == 7:
            yield float(struct.unpack(">d", data)[0])
        elif kind < 10:
            yield kind - 8
        else:
            yield data if kind % 2 == 0 else data.decode(errors="replace")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return a number of one to nine bytes, the first with the highest bits, and where it ends."""
    value = 0
    for _ in range(8):
        byte = data[at]
        at += 1
        value = value << 7 | byte & 127
        if byte < 128:
            return value, at
    return value << 8 | data[at], at + 1
