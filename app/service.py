"""What all requests share: settings, database, storage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from app.database import Database
from app.settings import Settings
from app.storage import LocalStorage, Storage


@dataclass(frozen=True)
class Service:
    """The parts of a running service."""

    settings: Settings
    database: Database
    storage: Storage

    @classmethod
    def open(cls, settings: Settings) -> Service:
        """Create the data folder where it is missing, and bring the database up to date."""
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        database = Database(settings.sqlalchemy_url)
        database.upgrade()
        return cls(settings, database, LocalStorage(settings.data_dir))


def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


ServiceDep = Annotated[Service, Depends(_service)]
