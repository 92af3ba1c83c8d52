from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tokt.inference.intake import InTurn, Newest, intake_of
from tokt.inference.runtime import POLL_S
from tokt.inference.sources import Frame

from .live import HandSource

PICTURE = np.zeros((4, 4), np.uint8)


def settled(intake: Newest, dropped: int) -> None:
    """Wait until the source's thread has passed everything on."""
    until = time.monotonic() + 5
    while intake.dropped < dropped and time.monotonic() < until:
        time.sleep(0.001)
    assert intake.dropped == dropped


def test_only_the_newest_frame_is_kept_and_what_it_overtook_is_missed() -> None:
    source = HandSource()
    intake = Newest(source)
    for missed in (0, 0, 2, 0):
        source.give(PICTURE, missed=missed)
    settled(intake, 3)
    frame = intake.take(POLL_S)
    assert frame is not None and frame.number == 4
    assert (frame.missed, intake.left_out) == (5, 3)  # frames 1 to 3, and the two before frame 3
    source.give(PICTURE)
    frame = intake.take(5)
    assert frame is not None and (frame.number, frame.missed, intake.left_out) == (5, 0, 0)
    intake.close()


def test_a_loop_that_waits_gets_nothing_and_then_the_frame_at_once() -> None:
    source = HandSource()
    intake = Newest(source)
    assert intake.take(0.01) is None and not intake.ended
    threading.Timer(0.02, source.give, [PICTURE]).start()
    frame = intake.take(5)
    assert frame is not None and frame.number == 1
    intake.close()
    assert intake.take(5) is None and intake.ended


def test_the_last_frame_of_an_ended_source_is_judged() -> None:
    source = HandSource()
    source.give(PICTURE)
    source.stop()
    intake = Newest(source)
    intake.close()
    assert not intake.ended
    assert intake.take(1) is not None
    assert intake.ended and intake.take(1) is None


def test_what_the_source_raises_reaches_the_loop_after_its_last_frame() -> None:
    source = HandSource()
    source.give(PICTURE)
    source.fail(RuntimeError("the driver is out of ideas"))
    intake = Newest(source)
    assert intake.take(5) is not None
    with pytest.raises(RuntimeError, match="out of ideas"):
        intake.take(5)
    intake.close()


def test_a_replay_without_a_rate_gives_every_frame() -> None:
    class Three:
        live = False

        def __iter__(self):  # type: ignore[no-untyped-def]
            return (Frame(number, 0.0, PICTURE, None) for number in (1, 2, 3))

        def stop(self) -> None: ...

    intake = intake_of(Three())
    assert isinstance(intake, InTurn)
    seen = [intake.take(POLL_S) for _ in range(4)]
    assert [frame and frame.number for frame in seen] == [1, 2, 3, None]
    assert intake.ended and intake.dropped == intake.left_out == 0
