"""The tables of a database are brought up to date: what the models have and the database lacks is added.

A version may add tables, indexes, and columns that can be null or have a default of the database: all of that follows
from the models, whatever version the database is of. What else it changes is a step of `_fill_in`. No table is ever
made anew that something refers to: on SQLite the rows that refer to its rows would go with it.
"""

from __future__ import annotations

from typing import cast

from sqlalchemy import Column, Connection, MetaData, String, Table, insert, inspect, select, update
from sqlalchemy.schema import CreateColumn

from app.store.models import Base, FeatureChunk, FeatureColumn, Job
from interloc.errors import InterLocError

VERSION = "0011"
"""Of the tables: one more where the models have more."""

_KNOWN = [f"{number:04}" for number in range(1, int(VERSION) + 1)]

_version = Table("alembic_version", MetaData(), Column("version_num", String(32), primary_key=True))
_tables = Base.metadata.tables


def bring_up_to_date(connection: Connection, shown: str) -> None:
    """Add what the database lacks, in a transaction of the caller.

    Parameters
    ----------
    shown
        Name of the database in messages.

    Raises
    ------
    InterLocError
        It was made by a newer version, or holds something else; nothing was changed.
    """
    there = set(inspect(connection).get_table_names())
    found = connection.scalar(select(_version)) if _version.name in there else None
    if found == VERSION:
        return
    if found not in {None, *_KNOWN}:
        raise InterLocError(
            f"the database {shown} was made by a newer version of InterLoc: its tables are {found!r}, those of this "
            f"version {VERSION!r}; install that version, or use another data folder"
        )
    if found is None and not there.isdisjoint(_tables):
        raise InterLocError(
            f"the database {shown} holds tables of something else ({', '.join(sorted(there & _tables.keys()))}); "
            "INTERLOC_DATABASE_URL must name an empty one, or that of this service"
        )
    _version.create(connection, checkfirst=True)
    if found is not None:
        if found < "0010":
            _forget_features(connection)
        _add_columns(connection)
    Base.metadata.create_all(connection)
    if found is None:
        connection.execute(insert(_version).values(version_num=VERSION))
        return
    if found < "0005":
        _name_jobs(connection)
    connection.execute(update(_version).values(version_num=VERSION))


def _add_columns(connection: Connection) -> None:
    """Add the columns and indexes that tables lack."""
    found = inspect(connection)
    for table in (each for each in Base.metadata.sorted_tables if found.has_table(each.name)):
        known = {each["name"] for each in found.get_columns(table.name)}
        for column in (each for each in table.columns if each.name not in known):
            described = CreateColumn(column).compile(dialect=connection.dialect)
            connection.exec_driver_sql(f"ALTER TABLE {table.name} ADD COLUMN {described}")
        indexed = {each["name"] for each in found.get_indexes(table.name)}
        for index in (each for each in table.indexes if each.name not in indexed):
            index.create(connection)


def _forget_features(connection: Connection) -> None:
    """Drop the index of features, which holds those of maps from now on, too: a start fills it in."""
    for model in (FeatureColumn, FeatureChunk):
        cast("Table", model.__table__).drop(connection, checkfirst=True)


def _name_jobs(connection: Connection) -> None:
    """Give jobs the names that stood in their requests only."""
    connection.execute(update(Job).values(name=Job.request["name"].as_string()))
