"""Databases as the first version left them."""

from __future__ import annotations

from sqlalchemy import inspect, text

from app.store.database import Database

TABLES = {
    "drives": "id name owner state options keep_raw report file_count size_bytes stored_bytes created_at touched_at",
    "drive_files": "drive_id path size_bytes sha256",
    "jobs": "id kind drive_id owner request idempotency_key state stage message done total version error summary "
    "created_at started_at finished_at attempts lease_owner lease_until cancel_requested",
    "tokens": "name sha256 created_at",
}
_LATER = ("feature_columns", "feature_chunks", "deliveries", "map_verdicts", "map_places", "map_drives", "maps")


def go_back(database: Database) -> None:
    """Take from a database what came after the first version; the rows that it knew stay."""
    with database.engine.connect().execution_options(writes=True) as connection, connection.begin():
        found = inspect(connection)
        for table in (*_LATER, "installation"):
            connection.execute(text(f"DROP TABLE {table}"))
        for table, columns in TABLES.items():
            newer = {each["name"] for each in found.get_columns(table)} - set(columns.split())
            for index in found.get_indexes(table):
                if newer.intersection(index["column_names"]):
                    connection.execute(text(f"DROP INDEX {index['name']}"))
            for column in sorted(newer):
                connection.execute(text(f"ALTER TABLE {table} DROP COLUMN {column}"))
        connection.execute(text("UPDATE alembic_version SET version_num = '0001'"))
