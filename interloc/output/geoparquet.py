"""A layer as GeoParquet, for DuckDB, GeoPandas and other programs that read columns."""

from __future__ import annotations

import importlib.util
import io
from typing import Any

from interloc.errors import ConfigError, install
from interloc.output.credits import Credit


def has_parquet() -> bool:
    """Return whether the extra is installed that writes GeoParquet."""
    return importlib.util.find_spec("pyarrow") is not None


def require_parquet() -> None:
    """Raise a ConfigError where the extra is not installed that writes GeoParquet."""
    if not has_parquet():
        raise ConfigError(f"GeoParquet needs pyarrow, which is not installed: {install('parquet')}")


def parquet_bytes(table: Any, description: str, credit: Credit) -> bytes:  # noqa: ANN401 - geopandas has no types
    """Return the file of a GeoDataFrame.

    Its metadata name `description`, `attribution` and, where there is one, `license`; each row has its own box, by
    which programs skip what lies elsewhere.
    """
    from pyarrow import parquet  # noqa: PLC0415 - an extra

    buffer = io.BytesIO()
    texts = dict.fromkeys(table.select_dtypes("object"), "string")  # they would have no type where all are null
    table.astype(texts).to_parquet(buffer, schema_version="1.1.0", write_covering_bbox=True)
    columns = parquet.read_table(io.BytesIO(buffer.getvalue()))
    told = {"description": description, **credit.members}
    made = io.BytesIO()
    parquet.write_table(columns.replace_schema_metadata({**columns.schema.metadata, **told}), made, compression="zstd")
    return made.getvalue()
