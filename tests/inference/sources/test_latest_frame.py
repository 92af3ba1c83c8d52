from __future__ import annotations

import threading

import numpy as np
import pytest

from tests.inference.live import HandSource
from tests.waiting import MAX_S, until
from tokt.inference.frame import Frame
from tokt.inference.runtime import POLL_S, EveryFrame, LatestFrameBuffer

PICTURE = np.zeros((4, 4), np.uint8)


def settled(buffer: LatestFrameBuffer, dropped: int) -> None:
    """Wait until the source's thread has passed everything on."""
    until(lambda: buffer.dropped >= dropped)
    assert buffer.dropped == dropped


def test_only_the_newest_frame_is_kept_and_what_it_overtook_is_missed() -> None:
    source = HandSource()
    buffer = LatestFrameBuffer(source)
    for missed in (0, 0, 2, 0):
        source.give(PICTURE, missed=missed)
    settled(buffer, 3)
    frame = buffer.take(POLL_S)
    assert frame is not None and frame.number == 4
    assert (frame.missed, buffer.left_out) == (5, 3)  # frames 1 to 3, and the two before frame 3
    source.give(PICTURE)
    frame = buffer.take(MAX_S)
    assert frame is not None and (frame.number, frame.missed, buffer.left_out) == (5, 0, 0)
    buffer.close()


def test_a_loop_that_waits_gets_nothing_and_then_the_frame_at_once() -> None:
    source = HandSource()
    buffer = LatestFrameBuffer(source)
    assert buffer.take(0.01) is None and not buffer.ended
    threading.Timer(0.02, source.give, [PICTURE]).start()
    frame = buffer.take(MAX_S)
    assert frame is not None and frame.number == 1
    buffer.close()
    assert buffer.take(MAX_S) is None and buffer.ended


def test_the_last_frame_of_an_ended_source_is_judged() -> None:
    source = HandSource()
    source.give(PICTURE)
    source.stop()
    buffer = LatestFrameBuffer(source)
    buffer.close()
    assert not buffer.ended
    assert buffer.take(MAX_S) is not None
    assert buffer.ended and buffer.take(MAX_S) is None


def test_what_the_source_raises_reaches_the_loop_after_its_last_frame() -> None:
    source = HandSource()
    source.give(PICTURE)
    source.fail(RuntimeError("the driver is out of ideas"))
    buffer = LatestFrameBuffer(source)
    assert buffer.take(MAX_S) is not None
    with pytest.raises(RuntimeError, match="out of ideas"):
        buffer.take(MAX_S)
    buffer.close()


def test_a_replay_without_a_rate_gives_every_frame() -> None:
    class Three:
        live = False

        def __iter__(self):  # type: ignore[no-untyped-def]
            return (Frame(number, 0.0, PICTURE, None) for number in (1, 2, 3))

        def stop(self) -> None: ...

    buffer = EveryFrame(Three())
    seen = [buffer.take(POLL_S) for _ in range(4)]
    assert [frame and frame.number for frame in seen] == [1, 2, 3, None]
    assert buffer.ended and buffer.dropped == buffer.left_out == 0
