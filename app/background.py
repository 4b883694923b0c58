"""What a server does on the side every few minutes, beside requests and jobs."""

from __future__ import annotations

import logging
import threading

from sqlalchemy.exc import SQLAlchemyError

from app.context import Context

_PERIOD_S = 120.0
_log = logging.getLogger(__name__)


class Background:
    """Makes the reserve of disk space again, and writes when tokens were last used, from `start` to `stop`."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="background", daemon=True)

    def start(self) -> None:
        """Begin, in the background."""
        self._thread.start()

    def stop(self) -> None:
        """End, having done it once more."""
        self._stopping.set()
        self._thread.join(5)

    def _run(self) -> None:
        is_last = False
        while True:
            self._context.reserve.fill()
            try:
                self._context.tokens.write_uses()
            except SQLAlchemyError as error:
                _log.warning("when tokens were last used could not be written: %s", error)
            if is_last:
                return
            is_last = self._stopping.wait(_PERIOD_S)
