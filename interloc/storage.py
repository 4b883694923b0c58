"""Object storage: what lies there is fetched into a folder, whole, before anything reads it; results are sent there.

obstore, which talks to the servers, is imported when the first address is used.
"""

import atexit
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import timedelta
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from interloc.errors import ConfigError, DriveError, NetworkError, OutputError, install
from interloc.files import PARTIAL, reason_of

SCHEMES = ("s3", "gs", "az", "https")
MAX_OBJECTS = 1_000_000
"""Of a drive, or of a prefix that drives are looked for in."""

_MADE_LAST = ("poses.txt", "reduced.json", "run.json")
"""Files by which drives and results are known."""

_URL = re.compile(r"(?P<scheme>[a-z0-9]+)://(?P<bucket>[^/]*)(?:/(?P<key>.*))?", re.DOTALL)
_THREADS = 8
_PIECE_BYTES = 8 * 1024 * 1024
_TRIES, _PATIENCE_S = 4, 60
_MAX_NAME_BYTES = 255
_SAME_TIME_S = 1e-3  # not every file system keeps times as finely as they are given

Argument = TypeVar("Argument")
Returned = TypeVar("Returned")


def is_url(text: str) -> bool:
    """Return whether a text is an address in object storage, or meant as one."""
    return re.match(r"[a-z0-9]+://", text) is not None


def is_within(address: str, prefixes: Sequence[str]) -> bool:
    """Return whether an address is one of some prefixes, or lies below one."""
    return any(f"{address.rstrip('/')}/".startswith(f"{prefix.rstrip('/')}/") for prefix in prefixes)


def check_address(address: str) -> tuple[str, str]:
    """Return the bucket of an address, and the key, or prefix, in it without slashes at its ends."""
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
    def of(cls, meta: Any) -> "StoredObject":  # noqa: ANN401 - of obstore, which is imported late
        """Take over what obstore tells of an object."""
        etag = meta["e_tag"]  # with quotes or without
        return cls(meta["path"], meta["size"], etag and etag.strip('"'), meta["last_modified"].timestamp())


@dataclass(frozen=True)
class Bucket:
    """The objects of a bucket, or of a host."""

    url: str
    """s3://bucket, gs://bucket, az://container or https://host."""

    @classmethod
    def of(cls, address: str) -> "tuple[Bucket, str]":
        """Return the bucket of an address, and the key, or prefix, in it without slashes at its ends."""
        url, key = check_address(address)
        bucket = cls(url)
        bucket.store  # noqa: B018 - whether it can be opened is asked now
        return bucket, key

    @property
    def store(self) -> Any:  # noqa: ANN401 - of obstore, which is imported late
        """The store of obstore."""
        return _open(self.url)

    def below(self, prefix: str, limit: int = MAX_OBJECTS) -> list[StoredObject]:
        """Return all objects below a prefix, in the order of their keys."""
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
        """Read bytes of an object."""
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
            if "BadScheme" in text:
                raise kind(
                    f"{address} cannot be {done}: the endpoint of the storage is in plain http://, which must be "
                    "allowed: AWS_ALLOW_HTTP=true (AZURE_ALLOW_HTTP=true)."
                ) from None
            if isinstance(error, FileNotFoundError):
                raise DriveError(f"{address} is not there. Usual cause: it was deleted or renamed meanwhile.") from None
            if self.url.startswith("https://") and done == "listed" and status:
                raise kind(
                    f"{address} cannot be listed ({said}): over https only WebDAV servers tell what a folder holds. "
                    "Give the address of a single recording (.mcap, .bag, .db3), or use s3://, gs:// or az://."
                ) from None
            wrong = "address" if self.url.startswith("https://") else "region or endpoint (AWS_REGION, AWS_ENDPOINT)"
            raise kind(
                f"{address} cannot be {done}: the server does not answer as expected ({said}). Usual cause: a wrong "
                f"{wrong}, or no connection."
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


def in_parallel(work: Callable[[Argument], Returned], arguments: Sequence[Argument]) -> Iterator[Returned]:
    """Do work that waits for servers, several at once; yield what it returns, in order. The first error ends it."""
    with ThreadPoolExecutor(_THREADS, "storage") as pool:
        yield from pool.map(work, arguments)  # which cancels what has not begun when it ends early


def fetch(
    bucket: Bucket,
    objects: Mapping[str, StoredObject],
    folder: Path,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> None:
    """Fetch objects, by path in a folder, several at once; a file that is there already with its size and time stays.

    `progress` is called with the bytes that were fetched, and with all of them; whatever it raises ends the fetching.
    """
    _check_names(objects, bucket)
    wanted = {folder / path: each for path, each in objects.items()}
    missing = {
        path: each
        for path, each in wanted.items()
        if not (path.is_file() and path.stat().st_size == each.size and _is_of_its_time(path, each))
    }
    total, done = sum(each.size for each in missing.values()), 0
    for place in {folder, *(path.parent for path in missing)}:
        place.mkdir(parents=True, exist_ok=True)
    if (free := shutil.disk_usage(folder).free) < total:
        raise OutputError(
            f"{bucket.url}: {total / 1e9:,.1f} GB are to be fetched into {folder}, and only {free / 1e9:,.1f} GB are "
            "free there. Set TMPDIR to a larger disk."
        )

    def fetch_piece(piece: tuple[Path, int]) -> int:
        path, start = piece
        each = missing[path]
        content = bucket.get(each, start, min(start + _PIECE_BYTES, each.size))
        descriptor = os.open(_partial(path), os.O_WRONLY | os.O_CREAT, 0o600)
        try:
            os.pwrite(descriptor, content, start)
        finally:
            os.close(descriptor)
        if each.size <= _PIECE_BYTES:
            _complete(path, each)
        return len(content)

    pieces = [(path, start) for path, each in missing.items() for start in range(0, each.size or 1, _PIECE_BYTES)]
    try:
        for count in in_parallel(fetch_piece, pieces):
            done += count
            progress(done, total)
        for path, each in missing.items():
            if each.size > _PIECE_BYTES:
                _complete(path, each)
    except OSError as error:
        raise OutputError(f"{bucket.url}: what is fetched could not be written: {reason_of(error)}.") from error


def _is_of_its_time(path: Path, each: StoredObject) -> bool:
    return abs(path.stat().st_mtime - each.modified_s) < _SAME_TIME_S


def _partial(path: Path) -> Path:
    return path.with_name(f"{PARTIAL}{hashlib.sha256(path.name.encode()).hexdigest()[:32]}")


def _complete(path: Path, each: StoredObject) -> None:
    os.utime(_partial(path), (each.modified_s, each.modified_s))
    _partial(path).replace(path)


def _check_names(paths: Collection[str], bucket: Bucket) -> None:
    if taken := {str(above) for path in paths for above in PurePosixPath(path).parents} & {*paths}:
        raise DriveError(f"{bucket.url} holds {min(taken)!r} as an object and as the prefix of others.")
    for path, part in ((each, part) for each in paths for part in each.split("/")):
        if part in {"", ".", ".."} or not part.isprintable() or len(part.encode()) > _MAX_NAME_BYTES or "\\" in part:
            raise DriveError(
                f"{bucket.url} holds an object that cannot be a file: {path[:200]!r}. Expected names of at most "
                f"{_MAX_NAME_BYTES} printable bytes between the slashes."
            )


# What a command has fetched, which goes when the process ends, and how it is called by messages.

_shown: dict[str, str] = {}
_folders: list[Path] = []


def temporary_folder() -> Path:
    """Return a new folder to fetch into; it goes when the process ends, or by `clear`."""
    folder = Path(tempfile.mkdtemp(prefix="interloc-"))
    _folders.append(folder)
    atexit.register(_remove, folder, os.getpid())
    return folder


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


@dataclass(frozen=True)
class ResultPlace:
    """A folder, or a file, whose contents belong to an address.

    Nothing but an older result is replaced there, and what a user has put beside it stays: files of the objects that
    are there already stand in the folder too, empty ones until `fetch_older` brings their contents.
    """

    path: Path
    bucket: Bucket
    key: str
    there: Mapping[str, StoredObject]
    """The objects that are there already, by path below the folder; "" is the key itself."""

    @classmethod
    def at(cls, address: str) -> "ResultPlace":
        """Make a temporary folder for an address."""
        bucket, key = Bucket.of(address)
        if not key or bucket.url.startswith("https://"):
            raise ConfigError(f"{address}: results are written to s3://bucket/prefix, gs://... or az://..., not there.")
        single = bucket.head(key)
        there = {each.key[len(key) + 1 :]: each for each in bucket.below(key)} if single is None else {"": single}
        place = cls(temporary_folder() / key.rpartition("/")[2], bucket, key, there)
        _check_names([name for name in there if name], bucket)
        for name, each in there.items():
            path = place.path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            os.utime(path, (each.modified_s, each.modified_s))
        for name in _MADE_LAST:  # of a result in which the address lies
            if bucket.head(f"{key.rpartition('/')[0]}/{name}".lstrip("/")) is not None:
                (place.path.parent / name).touch()
        return place

    def fetch_older(self, is_wanted: Callable[[str], bool] = lambda _: True) -> None:
        """Fetch what is there already."""
        wanted = {f"{self.path.name}/{name}".rstrip("/"): each for name, each in self.there.items() if is_wanted(name)}
        fetch(self.bucket, wanted, self.path.parent)

    def send(self, part: str = "") -> None:
        """Bring what is new in the folder, or in a part of it, there; the file that makes it a result comes last."""

        def is_older(path: Path, each: StoredObject) -> bool:  # as it was put there: empty, or with its contents
            return path.stat().st_size in {0, each.size} and _is_of_its_time(path, each)

        top = self.path / part
        before = {name: each for name, each in self.there.items() if f"{name}/".startswith(f"{part}/") or not part}
        found = [path for path in (top, *top.rglob("*")) if path.is_file()]
        files = {path.relative_to(self.path).as_posix() if path != self.path else "": path for path in found}
        new = [name for name, path in files.items() if name not in before or not is_older(path, before[name])]
        last = [name for name in new if name.rpartition("/")[2] in _MADE_LAST]
        begun = {self._key(f"{name.rpartition('/')[0]}/{PARTIAL}sent".lstrip("/")) for name in last}
        for key in begun:  # where such a file is not yet there, this tells `interloc.files` that the rest is ours
            self.bucket.put(key, b"")
        self.bucket.delete([self._key(name) for name in last if name in before])
        list(in_parallel(lambda name: self.bucket.put(self._key(name), files[name]), [n for n in new if n not in last]))
        for name in last:
            self.bucket.put(self._key(name), files[name])
        self.bucket.delete([self._key(name) for name in before if name not in files])
        with suppress(OutputError):  # some may write and not delete; beside a whole result it tells nothing
            self.bucket.delete([*begun])

    def _key(self, name: str) -> str:
        return f"{self.key}/{name}".rstrip("/")


_results: dict[Path, ResultPlace] = {}


def result_place(address: str) -> Path:
    """Return where to write a result that `send_results` will bring to an address."""
    place = ResultPlace.at(address)
    _results[place.path] = place
    show_as(place.path, address.rstrip("/"))
    return place.path


def fetch_older(path: Path, is_wanted: Callable[[str], bool] = lambda _: True) -> Path:
    """Fetch what lies at the address of a `result_place` already; of any other folder nothing. Return the folder."""
    if path in _results:
        _results[path].fetch_older(is_wanted)
    return path


def send_part(path: Path, name: str) -> None:
    """Bring a file of a `result_place` to its address now."""
    _results[path].send(name)


def send_results() -> None:
    """Bring what was written to each `result_place` to its address (`ResultPlace.send`)."""
    for place in _results.values():
        if place.path.exists():
            place.send()
    _results.clear()


def clear() -> None:
    """Remove all that a command has fetched, in a process that goes on."""
    for folder in _folders:
        shutil.rmtree(folder, ignore_errors=True)
    _folders.clear()
    _shown.clear()
    _results.clear()
