"""An answer to what nobody expected."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.problems import problem_of, respond


class Faults:
    """Turns an exception that no handler took into a problem document; it is logged, and not told."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Go on, and answer in the place of what failed."""
        has_begun = False

        async def send_and_note(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await self._app(scope, receive, send_and_note)
        except Exception as error:
            if scope["type"] != "http" or has_begun:  # half an answer is out: all that is left is to break it off
                raise
            await respond(problem_of(error), scope["path"])(scope, receive, send)
