"""A session in a thread of its own, behind a queue that drops the oldest scan when the session falls behind."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from interloc.errors import InterLocError
from interloc.live.documents import answer_document, intersection_document
from interloc.live.scan import LiveScan
from interloc.live.session import Answer, LiveSession

Say = Callable[[dict[str, Any], Answer | None], None]
"""Takes what a session says: the document for a client, and the answer that it was made of, if any."""

_log = logging.getLogger(__name__)


class LiveWorker:
    """Answers every scan that is put in, in its thread: with what was found, or that it was dropped or refused.

    `say` is called from the thread, but for dropped scans, which are reported by the thread that put the next one in;
    `keep` with each scan that was a keyframe, before it is answered. At most `queue_size` scans wait: a map of roads
    needs no scan in particular, and one that waits makes all after it late.
    """

    def __init__(
        self,
        session: LiveSession,
        say: Say,
        *,
        keep: Callable[[LiveScan], None] | None = None,
        queue_size: int = 4,
    ) -> None:
        self.session = session
        self._say = say
        self._keep = keep
        self._queue_size = queue_size
        self._waiting: deque[LiveScan] = deque()
        self._changed = threading.Condition()
        self._is_complete = False
        self._goes_on = True
        self.dropped = 0
        self._thread = threading.Thread(target=self._work, name="live", daemon=True)
        self._thread.start()

    def put(self, scan: LiveScan) -> None:
        """Hand in the next scan; never waits."""
        oldest = None
        with self._changed:
            if len(self._waiting) >= self._queue_size:
                oldest = self._waiting.popleft()
                self.dropped += 1
            self._waiting.append(scan)
            self._changed.notify()
        if oldest is not None:
            self._say({"type": "dropped", "frame": oldest.frame, "dropped": self.dropped}, None)

    def finish(self) -> None:
        """Let it answer what waits, the last keyframes too, and end; `join` waits for that."""
        with self._changed:
            self._is_complete = True
            self._changed.notify()

    def abandon(self) -> None:
        """End it without the last keyframes."""
        self._goes_on = False
        self.finish()

    def join(self) -> None:
        """Wait for the thread to end."""
        self._thread.join()

    def _work(self) -> None:
        try:
            while (scan := self._next()) is not None and self._goes_on:
                self._take(scan)
            if self._goes_on:
                for answer in self.session.finish():
                    self._say(answer_document(answer, dropped=self.dropped), answer)
                self._say(end_document(self.session, dropped=self.dropped), None)
        except Exception:  # noqa: BLE001 - whatever it is, the client gets a line
            _log.exception("a live session has failed")
            self._say({"type": "failed", "reason": "a fault of InterLoc itself; its log has the details."}, None)

    def _next(self) -> LiveScan | None:
        """Wait for the next scan; None where there are no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_complete)
            return self._waiting.popleft() if self._waiting else None

    def _take(self, scan: LiveScan) -> None:
        try:
            answer = self.session.push(scan)
            if answer.is_keyframe and self._keep is not None:
                self._keep(scan)
        except InterLocError as error:
            self._say({"type": "refused", "frame": scan.frame, "reason": str(error)}, None)
        else:
            self._say(answer_document(answer, scan, dropped=self.dropped), answer)


def end_document(session: LiveSession, *, dropped: int = 0) -> dict[str, Any]:
    """Return the last thing that a session says: how much it has seen, and its map."""
    return {
        "type": "end",
        "frame": session.last_frame,
        "keyframes": session.keyframes,
        "dropped": dropped,
        "intersections": [intersection_document(each) for each in session.map.intersections],
    }
