"""A real S3 server on this machine (moto's), and how to speak to it."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from interloc import storage

KEYS = {"AWS_ACCESS_KEY_ID": "somebody", "AWS_SECRET_ACCESS_KEY": "a-secret-of-the-test", "AWS_REGION": "us-east-1"}
BUCKET = "bucket"


def put(folder: Path, prefix: str) -> None:
    bucket, key = storage.Bucket.of(f"s3://{BUCKET}/{prefix}")
    storage.ResultPlace(folder, bucket, key, {}).send()


def keys_below(prefix: str) -> list[str]:
    bucket, key = storage.Bucket.of(f"s3://{BUCKET}/{prefix}")
    return [each.key.removeprefix(f"{key}/") for each in bucket.below(key)]


def content_of(path: str) -> bytes:
    bucket, key = storage.Bucket.of(f"s3://{BUCKET}/{path}")
    found = bucket.head(key)
    return bytes(bucket.get(found, 0, found.size))


@pytest.fixture(scope="module")
def s3() -> Iterator[str]:
    """Return the address of an S3 server with an empty bucket, which the environment names too."""
    moto = pytest.importorskip("moto.server", reason="moto, the S3 server of the tests, is not installed")
    pytest.importorskip("obstore", reason="obstore is not installed")
    from moto.s3.models import s3_backends  # noqa: PLC0415 - see above

    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    host, port = server.get_host_and_port()
    address = f"http://{host}:{port}"
    backend = s3_backends["123456789012"]["aws"]
    backend.reset()  # what an earlier module has left
    backend.create_bucket(BUCKET, "us-east-1")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**KEYS, "AWS_ENDPOINT": address, "AWS_ALLOW_HTTP": "true"}.items():
            patch.setenv(name, value)
        storage._open.cache_clear()
        yield address
    server.stop()
    storage.clear()
    storage._open.cache_clear()
