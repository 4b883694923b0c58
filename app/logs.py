"""The log on stderr: one JSON object per line, or text; each line of a request carries its id, its client, its job."""

import json
import logging
import sys
from contextvars import ContextVar
from datetime import UTC, datetime

from app.settings import Settings
from interloc.arrays import JsonObject

_context: ContextVar[JsonObject] = ContextVar("interloc_log_context", default={})  # noqa: B039 - never changed

_STANDARD = set(logging.LogRecord("", 0, "", 0, "", None, None).__dict__) | {"message", "asctime", "color_message"}
"""Attributes of every record; the others were given as ``extra``."""


def bind(**values: object) -> None:
    """Let all further lines of this request or thread carry these values, as ``job="9b1e"``."""
    _context.set({**_context.get(), **values})


def reset() -> None:
    """Forget what was bound."""
    _context.set({})


class JsonFormatter(logging.Formatter):
    """A record as one line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line: JsonObject = {
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


def _extra(record: logging.LogRecord) -> JsonObject:
    """Return what the record was given beside its message, and what is bound in the thread that logs it."""
    given = {name: value for name, value in record.__dict__.items() if name not in _STANDARD and value is not None}
    return {**_context.get(), **given}


def _one_line(text: str) -> str:
    """Escape what would begin a line of its own, in text that a client sent."""
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


def set_up(settings: Settings) -> None:
    """Send everything that this process logs to stderr, in the format of the settings."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if settings.log_format == "json" else TextFormatter())
    logging.basicConfig(handlers=[handler], level=logging.WARNING, force=True)  # the level is that of libraries
    for name in ("app", "interloc"):
        logging.getLogger(name).setLevel(settings.log_level.upper())
    # Start and stop are logged by the service itself; uvicorn's access log knows no route, no client and no job.
    logging.getLogger("uvicorn").setLevel(logging.WARNING)
    logging.captureWarnings(capture=True)
