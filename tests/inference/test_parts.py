"""The mechanism that opens the parts of a run, with parts that a test makes."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from tests.calls import refuses
from tests.waiting import until
from tokt.features.common.errors import ToktError, UnavailableError
from tokt.inference.assembly import parts as parts_module
from tokt.inference.assembly.parts import DETECTOR, RECEIVER, SOURCE, Part, RunParts
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.report import Event

BUSY = UnavailableError("the port is taken")
MISTAKE = ToktError("there is no such port")


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    monkeypatch.setattr(parts_module, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(parts_module, "MAX_PAUSE_S", 0.02)


@pytest.fixture
def run() -> Iterator[Callable[..., tuple[RunParts, list[Event]]]]:
    made: list[RunParts] = []

    def start(strict: bool = True) -> tuple[RunParts, list[Event]]:
        told: list[Event] = []
        made.append(RunParts(SYSTEM_CLOCK, told.append, strict))
        return made[-1], told

    yield start
    for parts in made:
        parts.close()


class Opened:
    """A part that opens once nothing stands in its way."""

    def __init__(self, error: Exception | None = None) -> None:
        self.error, self.tries, self.joined = error, 0, 0
        self.hangs = threading.Event()
        self.hangs.set()
        self.fails = ""

    def open(self) -> "Opened":
        self.tries += 1
        self.hangs.wait()
        if self.error is not None:
            raise self.error
        return self

    def join(self, opened: Any) -> None:
        assert opened is self
        self.joined += 1

    def part(self, option: str = "metrics", value: int = 9100, **more: Any) -> Part:
        return Part(option, value, self.open, self.join, fault=lambda opened: opened.fails, **more)


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("error", [BUSY, OSError(28, "No space left on device"), PermissionError()])
def test_what_the_system_refuses_is_told_once_and_tried_until_it_joins(run, strict, error):
    (parts, told), opened = run(strict), Opened(error)
    parts.add([opened.part()])
    until(lambda: opened.tries > 3)
    assert [event.name for event in told] == ["part_failed"] and not opened.joined
    assert told[0].fields == {"part": "--metrics 9100"}
    assert list(parts.faults) == ["--metrics 9100"]
    assert parts.health[1] == "without --metrics"
    opened.error = None
    until(lambda: (parts.join(), opened.joined)[1])
    assert [event.name for event in told] == ["part_failed", "part_joined"]
    assert parts.faults == {} and parts.health == ("", "")


def test_a_mistake_ends_a_strict_start_alone(run):
    parts, _ = run(strict=True)
    refuses("there is no such port", parts.add, [Opened(MISTAKE).part()])
    (parts, told), opened = run(strict=False), Opened(MISTAKE)
    parts.add([opened.part()])
    until(lambda: opened.tries > 2)
    assert [event.words for event in told] == ["--metrics is not working: there is no such port"]


def test_a_defect_of_one_part_costs_that_part_alone(run):
    (parts, told), opened = run(strict=False), Opened(ZeroDivisionError("nobody thought of it"))
    parts.add([opened.part()])
    until(lambda: opened.tries > 2)
    assert told[0].words.endswith("ZeroDivisionError: nobody thought of it")


def test_verdicts_depend_on_some_parts_and_a_strict_start_refuses_to_lack_them(run):
    parts, _ = run(strict=True)
    refuses("the port is taken", parts.add, [Opened(BUSY).part("mask", strict=True)])
    (parts, _), opened = run(strict=False), Opened(BUSY)
    parts.add([opened.part("mask", strict=True)])
    assert parts.health[1] == "without --mask"


def test_one_part_of_each_required_kind_is_enough(run):
    for strict in (True, False):
        (parts, _), lost, found = run(strict), Opened(BUSY), Opened()
        for value, opened in enumerate((lost, found)):
            parts.add([opened.part("udp", value, kind=RECEIVER)])
        assert parts.has(RECEIVER) and found.joined == 1
        if strict:
            refuses("taken", parts.has, SOURCE)
        else:
            assert not parts.has(DETECTOR)


def test_a_part_that_hangs_is_not_waited_for(run, monkeypatch):
    monkeypatch.setattr(parts_module, "PATIENCE_S", 0.01)
    (parts, told), opened = run(), Opened()
    opened.hangs.clear()
    parts.add([opened.part("log")])
    assert told[0].words == "--log is not working: it is not open after 0.01 s"
    opened.hangs.set()
    until(lambda: (parts.join(), opened.joined)[1])
    assert told[-1].name == "part_joined"


def test_a_part_that_fails_later_is_told_and_is_told_when_it_works_again(run):
    (parts, told), opened = run(), Opened()
    parts.add([opened.part("log")])
    opened.fails = "No space left on device"
    for _ in range(3):
        parts.join()
    assert parts.health[0] == "without --log: No space left on device"
    opened.fails = ""
    parts.join()
    assert [event.name for event in told] == ["part_failed", "part_joined"]
    assert opened.joined == 1


def test_a_part_that_opens_too_late_is_closed(run):
    (parts, _), closed = run(strict=False), []

    class Late(Opened):
        def close(self) -> None:
            closed.append(1)

    opened = Late(BUSY)
    parts.add([opened.part()])
    opened.error = None
    until(lambda: parts._opened)
    parts.close()
    assert closed == [1] and not opened.joined


def test_a_part_that_cannot_be_put_to_work_is_opened_again(run, monkeypatch):
    """Such as a calibration of another size, which may be mended."""
    (parts, told), closed = run(strict=False), []

    class Unfit(Opened):
        def join(self, opened: Any) -> None:
            if self.tries < 3:
                raise ToktError("it is of another size")
            super().join(opened)

        def close(self) -> None:
            closed.append(1)

    opened = Unfit()
    parts.add([opened.part("calibration")])
    assert told[0].words == "--calibration is not working: it is of another size"
    until(lambda: (parts.join(), opened.joined)[1])
    assert opened.tries == 3 and closed == [1, 1] and parts.faults == {}


def test_a_part_that_does_not_recover_is_opened_again(run):
    """Such as a challenger whose process was killed."""
    (parts, told), opened, left = run(), Opened(), []

    def leave(failed: Any) -> None:
        assert failed is opened
        left.append(1)
        opened.fails = ""

    parts.add([replace(opened.part("shadow"), leave=leave)])
    opened.fails = "its process was killed"
    parts.join()
    assert left == [1] and parts.health[1] == "without --shadow"
    until(lambda: (parts.join(), opened.joined == 2)[1])
    assert [event.name for event in told] == ["part_failed", "part_joined"]


def test_parts_that_hang_are_waited_for_together(run, monkeypatch):
    (parts, _), hung = run(strict=False), [Opened() for _ in range(20)]
    for opened in hung:
        opened.hangs.clear()
    # No time passes: each is waited for until the same moment.
    monkeypatch.setattr(parts_module, "time", SimpleNamespace(monotonic=lambda: 0.0))
    monkeypatch.setattr(parts_module, "PATIENCE_S", 0.001)
    parts.add(opened.part("udp", value) for value, opened in enumerate(hung))
    assert all(opened.tries == 1 for opened in hung)
    for opened in hung:
        opened.hangs.set()
