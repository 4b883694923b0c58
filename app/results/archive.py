"""A result folder as one .zip, packed while it is sent."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

_BLOCK = 256 * 1024
_PACKED = frozenset({".png", ".gz", ".zip"})


class _Sink(io.RawIOBase):
    """Takes what the packer writes until it is sent; nobody can seek in it."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, data: bytes | bytearray | memoryview, /) -> int:  # type: ignore[override]
        self._parts.append(bytes(data))
        return len(data)

    def take(self) -> bytes:
        parts, self._parts = self._parts, []
        return b"".join(parts)


def pack(folder: Path, names: list[Path], prefix: str) -> Iterator[bytes]:
    """Yield the bytes of an archive; the same files give the same bytes.

    Parameters
    ----------
    folder
    names
        Files, relative to the folder.
    prefix
        Folder that they lie in inside the archive.
    """
    sink = _Sink()
    with zipfile.ZipFile(sink, "w") as archive:
        for name in names:
            entry = zipfile.ZipInfo.from_file(folder / name, f"{prefix}/{name.as_posix()}", strict_timestamps=False)
            entry.compress_type = zipfile.ZIP_STORED if name.suffix in _PACKED else zipfile.ZIP_DEFLATED
            with (folder / name).open("rb") as source, archive.open(entry, "w") as packed:
                while block := source.read(_BLOCK):
                    packed.write(block)
                    if part := sink.take():
                        yield part
            yield sink.take()
    yield sink.take()
