"""Server-sent events: every open page hears of every change."""

import asyncio
import json
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any

from tokt.features.common.canonical import exact_numbers

from .board import LabelChanges

ALIVE_S = 2.0  # a comment that often, so that either side notices when the other is gone
ALIVE = ": alive\n\n"
"""A comment, which pages do not see."""


@dataclass(eq=False)
class Listener:
    """One open stream and what it has not been told yet."""

    changed: LabelChanges | None = None
    status: bool = False
    wake: asyncio.Event = field(default_factory=asyncio.Event)

    def hear(self, changed: LabelChanges | None) -> None:
        """A slow page gets several changes as one. None: the server's own state is another one."""
        if changed is None:
            self.status = True  # it is asked when it is told
        else:
            self.changed = changed if self.changed is None else self.changed.merged(changed)
        self.wake.set()

    def take(self) -> tuple[LabelChanges | None, bool]:
        """What is to be told now, and whether the server's own state is."""
        taken = self.changed, self.status
        self.changed, self.status = None, False
        self.wake.clear()
        return taken


class Broadcaster:
    """All open streams. `publish` may be called from any thread."""

    def __init__(self) -> None:
        self._listeners: set[Listener] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closed = False

    def start(self) -> None:
        """Belong to the running event loop from now on."""
        self._loop = asyncio.get_running_loop()

    def close(self) -> None:
        """End every stream; to be called in the event loop."""
        self._closed = True
        for listener in self._listeners:
            listener.wake.set()

    def publish(self, changed: LabelChanges | None = None) -> None:
        """Send a change to every page, or without one the server's own state as it is then."""

        def deliver() -> None:
            for listener in self._listeners:
                listener.hear(changed)

        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(deliver)

    async def listen(self) -> AsyncIterator[tuple[LabelChanges | None, bool]]:
        """Yield what is to be told, or (None, False) every `ALIVE_S`, until the server ends."""
        listener = Listener()
        self._listeners.add(listener)
        try:
            yield None, False  # from here on nothing is missed
            while not self._closed:
                try:
                    await asyncio.wait_for(listener.wake.wait(), ALIVE_S)
                except TimeoutError:
                    yield None, False
                    continue
                if not self._closed:
                    yield listener.take()
        finally:
            self._listeners.discard(listener)


def event_text(name: str, value: dict[str, Any]) -> str:
    """One event as it goes over the wire."""
    return f"event: {name}\ndata: {json.dumps(exact_numbers(value), allow_nan=False)}\n\n"
