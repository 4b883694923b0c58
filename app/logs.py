"""The log on stderr: a JSON object a line, or text; each line of a request carries its id, its client, its job."""

from __future__ import annotations

import json
import logging
import sys
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any

from app.settings import Settings

_context: ContextVar[dict[str, Any]] = ContextVar("interloc_log_context", default={})  # noqa: B039 - never changed

_STANDARD = set(logging.LogRecord("", 0, "", 0, "", None, None).__dict__) | {"message", "asctime", "color_message"}
"""What every record has; the rest was given as ``extra``."""


def bind(**values: object) -> None:
    """Let all further lines of this request or thread carry these values, as ``job="9b1e"``."""
    _context.set({**_context.get(), **values})


def reset() -> None:
    """Forget what was bound."""
    _context.set({})


class _AddContext(logging.Filter):
    """Puts what is bound into each record, in the thread that logs it."""

    def filter(self, record: logging.LogRecord) -> bool:
        for name, value in _context.get().items():
            if name not in record.__dict__:
                record.__dict__[name] = value
        return True


class JsonFormatter(logging.Formatter):
    """A record as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            **_extra(record),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str, ensure_ascii=False)


class TextFormatter(logging.Formatter):
    """A record as a line for people."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, with the traceback below it."""
        time = datetime.fromtimestamp(record.created, UTC).strftime("%H:%M:%S")
        more = "".join(f" {name}={value}" for name, value in _extra(record).items())
        line = f"{time} {record.levelname.lower():<7} {_one_line(record.getMessage())}{_one_line(more)}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


def _extra(record: logging.LogRecord) -> dict[str, Any]:
    return {name: value for name, value in record.__dict__.items() if name not in _STANDARD and value is not None}


def _one_line(text: str) -> str:
    """Keep what a client sent from making lines of its own."""
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


def set_up(settings: Settings) -> None:
    """Send everything that this process logs to stderr, in the format of the settings."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if settings.log_format == "json" else TextFormatter())
    handler.addFilter(_AddContext())
    root = logging.getLogger()
    for old in list(root.handlers):
        root.removeHandler(old)
    root.addHandler(handler)
    root.setLevel(logging.WARNING)  # of libraries
    for name in ("app", "interloc"):
        logging.getLogger(name).setLevel(settings.log_level.upper())
    # Its notes of starting and stopping are said by ours; its access log knows no route, no client and no job.
    logging.getLogger("uvicorn").setLevel(logging.WARNING)
    logging.captureWarnings(capture=True)
