"""Object storage: drives are read where they lie, and results are written there.

What lies below a prefix is laid out in a temporary folder: every object under its name and with its size, but without
its bytes, which takes no space on disk. So whatever reads a drive from a folder reads it here too; what it is about to
read is fetched by `present` (a file whole) or `open_binary` (the ranges that are read). Such a folder is known by its
name, so worker processes fetch what they need themselves. obstore, which talks to the servers, is imported when the
first address is used.
"""

from __future__ import annotations

import atexit
import hashlib
import io
import json
import mmap
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import timedelta
from functools import cache, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

from interloc.errors import ConfigError, DriveError, NetworkError, OutputError, install
from interloc.files import write_file

SCHEMES = ("s3", "gs", "az", "https")
MAX_OBJECTS = 1_000_000
"""Of a drive, or of a prefix that drives are looked for in."""

FOLDER = ".in-storage"
"""Name of every folder in which objects are laid out; hidden, so that nobody can upload one to a service."""

_INSIDE = f"{os.sep}{FOLDER}{os.sep}"
_LAID_OUT = "objects.json"
_MADE_LAST = ("poses.txt", "reduced.json", "run.json")
"""Files by which drives and results are known."""

_URL = re.compile(r"(?P<scheme>[a-z0-9]+)://(?P<bucket>[^/]*)(?:/(?P<key>.*))?", re.DOTALL)
_THREADS = 8
_PIECE_BYTES = 8 * 1024 * 1024
_BLOCK_BYTES = 16 * 1024
_TRIES, _PATIENCE_S = 4, 60
_MAX_NAME_BYTES = 255

Argument = TypeVar("Argument")
Returned = TypeVar("Returned")


def is_url(text: str) -> bool:
    """Return whether a text is an address in object storage, or meant as one."""
    return re.match(r"[a-z0-9]+://", text) is not None


def is_within(address: str, prefixes: Sequence[str]) -> bool:
    """Return whether an address is one of some prefixes, or lies below one."""
    return any(f"{address.rstrip('/')}/".startswith(f"{prefix.rstrip('/')}/") for prefix in prefixes)


def check_address(address: str) -> tuple[str, str]:
    """Return the bucket of an address, and the key, or prefix, in it without slashes at its ends.

    Raises
    ------
    ConfigError
        It is no such address.
    """
    match = _URL.fullmatch(address)
    if match is None or match["scheme"] not in SCHEMES or not match["bucket"]:
        raise ConfigError(
            f"{address.partition('?')[0][:200]!r} is not an address in object storage. Expected "
            "s3://bucket/prefix, gs://bucket/prefix, az://container/prefix or https://host/path."
        )
    if "@" in match["bucket"] or (match["scheme"] == "https" and "?" in address):
        raise ConfigError(
            f"{match['scheme']}://...: credentials and signatures do not belong into an address. They are read "
            "from the environment: AWS_ACCESS_KEY_ID and so on, as obstore documents."
        )
    key = (match["key"] or "").strip("/")
    if any(part in {"", ".", ".."} or not part.isprintable() for part in key.split("/")) and key:
        raise ConfigError(f"{address!r} holds an empty part, . or .., or what cannot be printed.")
    return f"{match['scheme']}://{match['bucket']}", key


@dataclass(frozen=True)
class StoredObject:
    """An object as it was listed."""

    key: str
    """In its bucket."""
    size: int
    etag: str | None
    """Another one where its content has changed; None where the store tells none."""
    modified_s: float
    """Seconds since 1970."""

    @classmethod
    def of(cls, meta: Any) -> StoredObject:  # noqa: ANN401 - of obstore, which is imported late
        """Take over what obstore tells of an object."""
        etag = meta["e_tag"]  # with quotes or without
        return cls(meta["path"], meta["size"], etag and etag.strip('"'), meta["last_modified"].timestamp())


@dataclass(frozen=True)
class Bucket:
    """The objects of a bucket, or of a host."""

    url: str
    """s3://bucket, gs://bucket, az://container or https://host."""

    @classmethod
    def of(cls, address: str) -> tuple[Bucket, str]:
        """Return the bucket of an address, and the key, or prefix, in it without slashes at its ends.

        Raises
        ------
        ConfigError
            It is no such address, or obstore is not installed.
        """
        url, key = check_address(address)
        bucket = cls(url)
        bucket.store  # noqa: B018 - whether it can be opened is asked now
        return bucket, key

    @property
    def store(self) -> Any:  # noqa: ANN401 - of obstore, which is imported late
        """The store of obstore."""
        return _open(self.url)

    def below(self, prefix: str, limit: int = MAX_OBJECTS) -> list[StoredObject]:
        """Return all objects below a prefix, in the order of their keys.

        Raises
        ------
        NetworkError, DriveError
            They cannot be listed, are too many, or one has a name that no file can have.
        """
        found: list[StoredObject] = []
        with self._asking(f"{self.url}/{prefix}", "listed"):
            for chunk in self.store.list(prefix or None, chunk_size=1000):
                found += map(StoredObject.of, chunk)
                if len(found) > limit:
                    raise DriveError(
                        f"{self.url}/{prefix} holds more than {limit:,} objects. Give the prefix of the drive itself."
                    )
        return sorted((each for each in found if not each.key.endswith("/")), key=lambda each: each.key)

    def directly_below(self, prefix: str) -> list[StoredObject]:
        """Return the objects directly below a prefix, without those of its folders."""
        with self._asking(f"{self.url}/{prefix}", "listed"):
            return list(map(StoredObject.of, self.store.list_with_delimiter(prefix or None)["objects"]))

    def head(self, key: str) -> StoredObject | None:
        """Return an object by its key; None where there is none."""
        with self._asking(f"{self.url}/{key}", "read"):
            try:
                return StoredObject.of(self.store.head(key))
            except FileNotFoundError:
                return None

    def get(self, wanted: StoredObject, start: int, stop: int) -> memoryview:
        """Read bytes of an object.

        Raises
        ------
        NetworkError, DriveError
            It cannot be read, or is another one than was listed.
        """
        address = f"{self.url}/{wanted.key}"
        if stop <= start:
            return memoryview(b"")
        with self._asking(address, "read"):
            found = self.store.get(wanted.key, options={"range": (start, stop)})
            now = StoredObject.of(found.meta)
            if now.size != wanted.size or (wanted.etag and now.etag and now.etag != wanted.etag):
                raise DriveError(
                    f"{address} was changed while it was read ({wanted.size:,} bytes when it was listed, {now.size:,} "
                    "now). Start again when nothing writes to it."
                )
            content = memoryview(found.bytes())
        if len(content) != stop - start:
            raise NetworkError(f"{address} could not be read: {len(content):,} of {stop - start:,} bytes came.")
        return content

    def put(self, key: str, content: Path | bytes) -> None:
        """Write an object; a large file in several parts."""
        with self._asking(f"{self.url}/{key}", "written"):
            self.store.put(key, content)

    def delete(self, keys: Sequence[str]) -> None:
        """Delete objects."""
        if keys:
            with self._asking(f"{self.url}/{keys[0]}", "deleted"):
                self.store.delete(list(keys))

    @contextmanager
    def _asking(self, address: str, done: str) -> Iterator[None]:
        """Turn what obstore raises into one line; nothing of its text is passed on that may hold a signature."""
        from obstore.exceptions import BaseError, InvalidPathError  # noqa: PLC0415 - an extra

        try:
            yield
        except InvalidPathError as error:
            named = re.search(r'path:? "([^"]{1,200})', str(error))
            raise DriveError(
                f"{address} holds an object that cannot be a file: {named[1] if named else 'its name'!r}. Usual "
                "cause: a name with an empty part, . or .. in it."
            ) from None
        except (BaseError, OSError, ValueError) as error:
            text, kind = str(error), NetworkError if done in {"listed", "read"} else OutputError
            code = re.search(r"<Code>(\w{1,64})</Code>", text)
            status = re.search(r"status code: (\d{3})", text)
            said = " ".join(each[1] for each in (status, code) if each) or type(error).__name__
            if "NoSuchBucket" in text or "ContainerNotFound" in text:
                raise kind(f"{address} cannot be {done}: there is no bucket {self.url} ({said}).") from None
            if "169.254.169.254" in text or "metadata.google" in text:
                said = "no credentials were found"
            if said.startswith(("401", "403")) or "credentials" in said or "Unauthenticated" in said:
                raise kind(
                    f"{address} cannot be {done}: no permission ({said}). Credentials are read from the environment: "
                    "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_SKIP_SIGNATURE=true for a public bucket; "
                    "GOOGLE_SERVICE_ACCOUNT; AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY."
                ) from None
            if isinstance(error, FileNotFoundError):
                raise DriveError(f"{address} is not there. Usual cause: it was deleted or renamed meanwhile.") from None
            if self.url.startswith("https://") and done == "listed" and status:
                raise kind(
                    f"{address} cannot be listed ({said}): over https only WebDAV servers tell what a folder holds. "
                    "Give the address of a single recording (.mcap, .bag, .db3), or use s3://, gs:// or az://."
                ) from None
            raise kind(
                f"{address} cannot be {done}: the server does not answer as expected ({said}). Usual cause: a wrong "
                "region or endpoint (AWS_REGION, AWS_ENDPOINT), or no connection."
            ) from None


@cache
def _open(url: str) -> Any:  # noqa: ANN401 - of obstore, which is imported late
    """Open a store; whom it trusts and as whom it comes is said by the environment."""
    try:
        from obstore import store  # noqa: PLC0415 - an extra
        from obstore.exceptions import BaseError  # noqa: PLC0415
    except ImportError as error:
        raise ConfigError(f"{url} needs the package obstore. Install it with: {install('storage')}") from error
    scheme, _, name = url.partition("://")
    how: dict[str, Any] = {"retry_config": {"max_retries": _TRIES, "retry_timeout": timedelta(seconds=_PATIENCE_S)}}
    try:
        if scheme == "https":
            return store.HTTPStore.from_url(url, **how)
        kind = {"s3": store.S3Store, "gs": store.GCSStore, "az": store.AzureStore}[scheme]
        return kind(name, **how)
    except (BaseError, ValueError) as error:
        raise ConfigError(
            f"{url} cannot be opened by what the environment says ({type(error).__name__}). Expected credentials as "
            "obstore documents them: AWS_..., GOOGLE_... or AZURE_... ."
        ) from None


class LaidOut:
    """A folder in which objects are laid out.

    Parameters
    ----------
    root
        Folder that the files lie in, and what is noted of them.

    Attributes
    ----------
    objects : dict of str to StoredObject
        Path in the folder -> object.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.files = root / "files"
        noted = json.loads((root / _LAID_OUT).read_bytes())
        self.bucket = Bucket(noted["bucket"])
        self.objects = {path: StoredObject(**each) for path, each in noted["objects"].items()}

    @classmethod
    def at(cls, root: Path) -> LaidOut | None:
        """Return what was laid out in a folder before, if that came to its end."""
        return _laid_out(str(root)) if (root / _LAID_OUT).is_file() else None

    @classmethod
    def make(cls, root: Path, bucket: Bucket, objects: Mapping[str, StoredObject]) -> LaidOut:
        """Lay out objects in a folder of the name `FOLDER`.

        Raises
        ------
        DriveError
            A name cannot be that of a file.
        """
        for path in objects:
            _check_name(path, bucket)
        shutil.rmtree(root / "files", ignore_errors=True)  # of an attempt that was killed
        made: set[Path] = set()
        for path, each in objects.items():
            target = root / "files" / path
            try:
                if target.parent not in made:
                    target.parent.mkdir(parents=True, exist_ok=True)
                    made.add(target.parent)
                _make_empty(target, each)
            except (FileExistsError, NotADirectoryError):
                raise DriveError(f"{bucket.url} holds {path!r} as an object and as the prefix of others.") from None
        root.mkdir(parents=True, exist_ok=True)
        noted = {"bucket": bucket.url, "objects": {path: asdict(each) for path, each in objects.items()}}
        write_file(root / _LAID_OUT, json.dumps(noted))
        return _laid_out(str(root))

    def _object(self, path: Path) -> StoredObject | None:
        return self.objects.get(path.relative_to(self.files).as_posix())

    def below(self, place: Path) -> dict[str, StoredObject]:
        """Return the objects that were laid out in a folder, by path there."""
        start = f"{place.relative_to(self.files).as_posix()}/"
        return {path[len(start) :]: each for path, each in self.objects.items() if path.startswith(start)}

    def blocks_file(self, path: Path) -> Path:
        """Return where it is noted which blocks of a large file are here."""
        return self.root / f"blocks-{hashlib.sha256(os.fsencode(path)).hexdigest()[:32]}"

    def fetch(self, path: Path) -> None:
        """Fetch a file whole, unless it is here."""
        wanted = self._object(path)
        if wanted is None or not self.is_missing(path):
            return
        if wanted.size > _PIECE_BYTES or self.blocks_file(path).exists():
            with self.open(path) as file:
                file.ensure([(0, wanted.size)])
            return
        temporary = self.root / f"partial-{secrets.token_hex(8)}"
        with temporary.open("wb") as file_:
            file_.write(self.bucket.get(wanted, 0, wanted.size))
        os.utime(temporary, (wanted.modified_s, wanted.modified_s))
        temporary.replace(path)

    def is_missing(self, path: Path) -> bool:
        """Return whether bytes of a file may not be here."""
        try:
            return not path.stat().st_mode & stat.S_IRUSR or self.blocks_file(path).exists()
        except FileNotFoundError:  # its reader says so
            return False

    def forget(self, path: Path) -> None:
        """Give up the bytes of a file; they are fetched again where they are needed again."""
        wanted = self._object(path)
        if wanted is not None and not self.is_missing(path):
            path.unlink(missing_ok=True)
            _make_empty(path, wanted)

    def open(self, path: Path) -> RangeFile:
        """Open a file of which only what is read is fetched."""
        wanted = self._object(path)
        assert wanted is not None
        return RangeFile(self.bucket, wanted, path, self.blocks_file(path))


class RangeFile(io.RawIOBase):
    """A large object: blocks of it are fetched when they are read; once for all processes that read it here."""

    def __init__(self, bucket: Bucket, wanted: StoredObject, path: Path, noted: Path) -> None:
        self._bucket, self._wanted, self._at = bucket, wanted, 0
        count = max(1, -(-wanted.size // _BLOCK_BYTES))
        descriptor = os.open(noted, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            os.truncate(descriptor, count)
            self._here = mmap.mmap(descriptor, count)
        finally:
            os.close(descriptor)
        path.chmod(0o600)
        self._file = os.open(path, os.O_RDWR)

    def ensure(self, ranges: Iterable[tuple[int, int]]) -> None:
        """Fetch the blocks that some ranges (start, stop) lie in, where they are not here; several at once."""
        most, done = _PIECE_BYTES // _BLOCK_BYTES, 0
        runs: list[tuple[int, int]] = []
        for start, stop in sorted(ranges):
            first, last = max(done, start // _BLOCK_BYTES), min(-(-stop // _BLOCK_BYTES), len(self._here))
            for run in re.finditer(rb"\0+", self._here[first:last]):
                edges = [*range(first + run.start(), first + run.end(), most), first + run.end()]
                runs += pairwise(edges)
            done = max(done, last)
        in_parallel(self._fetch, runs)

    def _fetch(self, run: tuple[int, int]) -> None:
        start, stop = run[0] * _BLOCK_BYTES, min(run[1] * _BLOCK_BYTES, self._wanted.size)
        os.pwrite(self._file, self._bucket.get(self._wanted, start, stop), start)
        self._here[run[0] : run[1]] = b"\1" * (run[1] - run[0])

    def readinto(self, buffer: Any) -> int:  # noqa: ANN401 - as of `io.RawIOBase`
        """Read into a buffer."""
        count = max(0, min(len(buffer), self._wanted.size - self._at))
        blocks = self._here[self._at // _BLOCK_BYTES : -(-(self._at + count) // _BLOCK_BYTES)]
        if count and b"\0" in blocks:
            self.ensure([(self._at, self._at + count)])
        data = os.pread(self._file, count, self._at)
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a place."""
        self._at = offset + (0, self._at, self._wanted.size)[whence]
        return self._at

    def tell(self) -> int:
        """Return the place."""
        return self._at

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def close(self) -> None:
        """Close the file; what was fetched stays here."""
        if not self.closed:
            os.close(self._file)
            self._here.close()
        super().close()


def in_parallel(work: Callable[[Argument], Returned], arguments: Sequence[Argument]) -> list[Returned]:
    """Do work that waits for servers, several at once; the first error ends it."""
    if len(arguments) < 2:
        return [work(each) for each in arguments]
    pool = ThreadPoolExecutor(_THREADS, "storage")
    try:
        return list(pool.map(work, arguments))
    finally:
        pool.shutdown(cancel_futures=True)


@lru_cache(maxsize=16)
def _laid_out(root: str) -> LaidOut:
    return LaidOut(Path(root))


def _of(path: Path) -> LaidOut | None:
    head, inside, rest = os.fspath(path).partition(_INSIDE)
    return _laid_out(f"{head}{os.sep}{FOLDER}") if inside and rest.startswith(f"files{os.sep}") else None


def is_elsewhere(path: Path) -> bool:
    """Return whether a path leads to what is laid out of object storage."""
    return _INSIDE in os.fspath(path)


def present(path: Path) -> Path:
    """Return the path of a file whose bytes are here: of one in object storage they are fetched first.

    Raises
    ------
    NetworkError, DriveError
        It cannot be read, or was changed since it was listed.
    """
    if is_elsewhere(path) and (folder := _of(path)) is not None:
        folder.fetch(path)
    return path


def present_below(place: Path) -> Path:
    """Return a folder all of whose files are here."""
    if is_elsewhere(place) and (folder := _of(place)) is not None:
        in_parallel(folder.fetch, [place / name for name in folder.below(place)])
    return place


def forget(paths: Iterable[Path]) -> None:
    """Give up the bytes of files that lie in object storage, so that they take no space here."""
    for path in paths:
        if is_elsewhere(path) and (folder := _of(path)) is not None:
            folder.forget(path)


def open_binary(path: Path) -> BinaryIO:
    """Open a file to be read by ranges; of one in object storage only these are fetched."""
    folder = _of(path) if is_elsewhere(path) else None
    if folder is None or not folder.is_missing(path):
        return path.open("rb")
    return cast("BinaryIO", folder.open(path))


def want(file: BinaryIO, ranges: Iterable[tuple[int, int]]) -> None:
    """Tell which ranges (start, stop) of a file from `open_binary` will be read: they are fetched several at once."""
    if isinstance(file, RangeFile):
        file.ensure(ranges)


def _check_name(path: str, bucket: Bucket) -> None:
    for part in path.split("/"):
        if part in {"", ".", ".."} or not part.isprintable() or len(part.encode()) > _MAX_NAME_BYTES or "\\" in part:
            raise DriveError(
                f"{bucket.url} holds an object that cannot be a file: {path[:200]!r}. Expected names of at most "
                f"{_MAX_NAME_BYTES} printable bytes between the slashes."
            )


def _make_empty(path: Path, each: StoredObject) -> None:
    """Make a file of a size without contents, which its owner may not read: no reader takes it for what it stands."""
    descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, stat.S_IWUSR)
    try:
        os.truncate(descriptor, each.size)
    finally:
        os.close(descriptor)
    os.utime(path, (each.modified_s, each.modified_s))


# What a command has made here, which goes when the process ends, and how it is called by messages.

_shown: dict[str, str] = {}
_results: dict[Path, tuple[Bucket, str]] = {}


def temporary_folder() -> Path:
    """Return a new folder in which objects can be laid out; it goes when the process ends, or by `clear`."""
    folder = Path(tempfile.mkdtemp(prefix="interloc-"))
    atexit.register(_remove, folder, os.getpid())
    return folder / FOLDER


def _remove(folder: Path, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def show_as(path: Path, address: str) -> None:
    """Have `shown` write a path as the address of what it stands for."""
    _shown[str(path)] = address


def shown(text: str) -> str:
    """Return a text in which addresses stand for the temporary folders of what they mean."""
    for path, address in _shown.items():
        text = text.replace(path, address)
    return text


def result_place(address: str) -> Path:
    """Return where to write a result that `send_results` will bring to an address.

    What is there already is laid out, so that what holds for folders holds there too: nothing but an older result is
    replaced, and what a user has put beside it stays.
    """
    bucket, key = Bucket.of(address)
    if not key or bucket.url.startswith("https://"):
        raise ConfigError(f"{address}: results are written to s3://bucket/prefix, gs://... or az://..., not there.")
    folder, name, single = temporary_folder(), key.rpartition("/")[2], bucket.head(key)
    there = {f"{name}/{each.key[len(key) + 1 :]}": each for each in bucket.below(key)}
    LaidOut.make(folder, bucket, there if single is None else {name: single})
    place = folder / "files" / name
    place.parent.mkdir(exist_ok=True)
    _results[place] = bucket, key
    show_as(place, address.rstrip("/"))
    return place


def take_result(place: Path) -> tuple[Bucket, str] | None:
    """Return where a `result_place` belongs, for whoever sends its parts; None for any other folder."""
    return _results.pop(place, None)


def send_results() -> None:
    """Bring what was written to `result_place` to its address; the file that makes it a result comes last.

    Raises
    ------
    OutputError
        It could not be written. What is there then is no result yet; the same command does it again.
    """
    for place, (bucket, key) in _results.items():
        if place.exists():
            send(place, bucket, key)
    _results.clear()


def send(place: Path, bucket: Bucket, key: str) -> None:
    """Bring a file, or what is new in a folder, to a key; what an older result there had beside it is deleted."""
    if place.is_file():
        bucket.put(key, place)
        return
    folder = _of(place)
    before = {} if folder is None else folder.below(place)
    files = {path.relative_to(place).as_posix(): path for path in place.rglob("*") if path.is_file()}
    new = [name for name, path in files.items() if folder is None or not folder.is_missing(path)]
    last = [name for name in new if name.rpartition("/")[2] in _MADE_LAST]
    bucket.delete([f"{key}/{name}" for name in last if name in before])
    in_parallel(lambda name: bucket.put(f"{key}/{name}", files[name]), [name for name in new if name not in last])
    for name in last:
        bucket.put(f"{key}/{name}", files[name])
    bucket.delete([f"{key}/{name}" for name in before if name not in files])


def clear() -> None:
    """Remove all that a command has laid out, in a process that goes on."""
    for path in [*_shown]:
        shutil.rmtree(path.partition(_INSIDE)[0], ignore_errors=True)
    _shown.clear()
    _results.clear()
    _laid_out.cache_clear()
