"""Faults of frames, detectors, networks, disks and clocks: what is said, and never a wrong clear.

Every test puts one fault into a dive between a healthy stretch before it and one after it. What it
came to is a row of docs/faults.md, and the test fails where the two differ.
"""

import re
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tokt.inference.config import Limits
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.outputs.udp import UdpSender
from tokt.inference.policy.policy import EitherPolicy, FallbackPolicy
from tokt.inference.publisher import Observer
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.run_log import RunLog
from tokt.inference.verdict import Detection
from tokt.models.operating_point import MofNRule, OperatingPoint

from ..waiting import MAX_S
from .conftest import HandClock, NoiseScorer
from .dive import Dive, Outcome, healthy
from .live import bound_socket

TABLE = Path(__file__).parents[2] / "docs" / "faults.md"
RNG = np.random.default_rng(7)


def hold_row(fault: str, comes_to: str, counted: str) -> None:
    """Hold a row of three cells against the documented ones."""
    line = f"| {fault} | {comes_to} | {counted} |"
    assert line in TABLE.read_text().splitlines(), f"docs/faults.md has no row\n{line}"


def row(fault: str, outcome: Outcome, counted: str) -> None:
    """Hold what happened against the documented row."""
    said = sorted(outcome.of("fault") | outcome.of("-"))
    words = ", ".join(f"{status} `{reason}`" for status, reason in said) or "as without it"
    hold_row(fault, words, counted)


def finish(dive: Dive) -> Outcome:
    """The healthy stretches were seen as they are, whatever was between them."""
    outcome = dive.outcome()
    statuses = {(what, status) for what, status, _ in outcome.said if what in ("clear", "obstacle")}
    assert statuses == {("clear", "clear"), ("obstacle", "obstacle")}
    return outcome


def noise(mean: float, sigma: float) -> np.ndarray:
    return np.clip(RNG.normal(mean, sigma, (271, 360)), 0, 255).astype(np.uint8)


def cut_off() -> np.ndarray:
    picture = noise(60, 9)
    picture[200:] = 128
    return picture


FRAMES: dict[str, tuple[Reason, Callable[[], np.ndarray] | None]] = {
    "lens covered, lamp out: a dark frame": (Reason.DARK, lambda: noise(2, 1)),
    "glare: a saturated frame": (Reason.SATURATED, lambda: noise(254, 3)),
    "a frame of one grey": (Reason.BLANK, lambda: np.full((271, 360), 90, np.uint8)),
    "the end of a frame zeroed or gray": (Reason.DAMAGED, cut_off),
    "a frame of another size": (Reason.WRONG_SIZE, lambda: noise(60, 9)[:200, :200]),
    "an array that is no picture": (Reason.WRONG_SIZE, lambda: noise(60, 9)[:, :, None]),
    "no such frame": (Reason.MISSING, None),
    "a file that cannot be decoded": (Reason.UNREADABLE, None),
    "a torn frame: the camera gave a part of it": (Reason.INCOMPLETE, None),
    "a camera unplugged": (Reason.CAMERA_LOST, None),
    "no frame of the other camera's moment": (Reason.UNPAIRED, None),
}


@pytest.mark.parametrize("fault", FRAMES)
def test_a_frame_that_cannot_be_judged(fault):
    reason, picture = FRAMES[fault]
    dive = Dive()
    with dive.fault_between():
        if picture is None:
            dive.fault(Fault(reason, "no picture"))
        else:
            dive.give("fault", picture())
    outcome = finish(dive)
    row(fault, outcome, f"frames by reason: {reason.value} +{outcome.summary.reasons[reason]}")


def test_a_frozen_camera():
    dive = Dive()
    with dive.fault_between():
        same = dive.picture("clear")
        dive.give("clear", same)
        dive.clock.now += 1.25 * dive.limits.stale_s
        for _ in range(3):
            dive.give("fault", same.copy())
    outcome = finish(dive)
    assert outcome.summary.reasons["frozen"] == 3
    outcome.said = [one for one in outcome.said if one[0] != "-"]
    row("a frozen camera: the same picture again", outcome, "frames by reason: frozen")


def test_a_frame_that_comes_too_old():
    dive = Dive()
    with dive.fault_between():
        dive.give("fault", dive.picture("clear"), age_s=0.3)
    row("a frame older than `--stale` when it comes", finish(dive), "frames by reason: stale +1")


def test_no_frame_from_the_start():
    dive = Dive()
    with dive.under_way():
        dive.silence()
        dive.silence()
        healthy(dive)
    row("no frame since the start", finish(dive), "heartbeats")


def test_frames_stop_coming():
    dive = Dive()
    with dive.fault_between():
        dive.silence()
        dive.silence()
    row("frames stop coming", finish(dive), "heartbeats")


def test_a_detector_that_raises():
    dive = Dive()

    def fails(frame: Frame) -> None:
        raise MemoryError("out of memory")

    with dive.fault_between():
        dive.detector.before = fails
        dive.give("fault", dive.picture("clear"))
        dive.detector.before = lambda frame: None
    row("a detector raises", finish(dive), "frames by reason: detector_failed +1")


def test_a_decision_value_that_is_no_number():
    class Broken(NoiseScorer):
        broken = False

        def values_of(self, features: Any) -> Any:
            return super().values_of(features) * (np.nan if self.broken else 1)

    scorer = Broken()
    dive = Dive(scorer=scorer)
    with dive.fault_between():
        scorer.broken = True
        dive.give("fault", dive.picture("clear"))
        scorer.broken = False
    row("a decision value is NaN", finish(dive), "frames by reason: not_finite +1")


@pytest.mark.parametrize(
    ("what", "fault"),
    [
        ("clear", "a detector takes too long: what it then calls clear"),
        ("obstacle", "a detector takes too long: what it then calls an obstacle"),
    ],
)
def test_a_detector_that_hangs_for_a_while(what, fault):
    dive = Dive()
    with dive.fault_between():
        dive.detector.before = lambda frame: dive.silence()
        dive.give("fault", dive.picture(what))
        dive.detector.before = lambda frame: None
    row(fault, finish(dive), "frames by reason: late +1; heartbeats")


def test_frames_faster_than_they_are_judged():
    dive = Dive(limits=Limits(5, 5))
    go = threading.Event()
    with dive.fault_between():
        dive.detector.before = lambda frame: go.wait(MAX_S) and None
        judged = len(dive.listener.reports)
        dive.give_at_once("clear")
        dive.until(lambda: dive.taken_up())
        dive.give_at_once("obstacle", "clear", "clear", "obstacle")
        dive.pass_on()
        go.set()
        dive.until(lambda: len(dive.listener.reports) == judged + 2)
        dive.detector.before = lambda frame: None
    outcome = finish(dive)
    assert outcome.summary.dropped == 3 and ("obstacle", "overload") in outcome.of("obstacle")
    outcome.said = [
        ("fault", status, reason) for _, status, reason in outcome.said if reason == "overload"
    ]
    row("more frames than there is time for", outcome, "dropped +3; frames by reason: overload +1")


def test_frames_are_missing_that_the_frame_rule_needs():
    dive = Dive(scorer=NoiseScorer(operating_point=OperatingPoint(MofNRule(0, 1, 2, 3))))
    with dive.under_way():
        dive.give("clear")
        dive.give("clear")
        dive.give("fault", dive.picture("obstacle"), missed=MANY_MISSED)
        dive.give("obstacle")
        dive.give("fault", dive.picture("clear"))  # 2 of the last 3 frames showed it
        dive.give("clear")
    outcome = dive.outcome()
    assert ("fault", "obstacle", "ok") in outcome.said
    assert ("obstacle", "obstacle", "ok") in outcome.said
    assert outcome.said[-1] == ("clear", "clear", "ok")
    outcome.said = [one for one in outcome.said if one[2] == "frame_rule"]
    row("frames missing that the frame rule needs", outcome, "frames by reason: frame_rule")


@pytest.mark.parametrize(
    ("fault", "host"),
    [
        ("a receiver gone: the system answers that nobody listens", "127.0.0.1"),
        # Class E addresses are never routed (RFC 1112, section 4).
        ("a receiver that no route leads to", "240.0.0.1"),
    ],
)
def test_a_receiver_that_nothing_reaches(closed_port, fault, host):
    gone = [UdpSender(host, closed_port, version) for version in (1, 2)]
    dive = Dive(senders=list(gone))
    with dive.under_way():
        for _ in range(5):
            healthy(dive)
    for sender in gone:
        assert sender.sent + sender.failed >= 10
        sender.close()
    row(fault, finish(dive), "sent or failed")


def test_a_receiver_that_does_not_read():
    with bound_socket() as full:
        full.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        sender = UdpSender(*full.getsockname(), 2)
        dive = Dive(senders=[sender])
        with dive.under_way():
            for _ in range(20):
                healthy(dive)
        row("a receiver that does not read", finish(dive), "sent")
        sender.close()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full (Linux)")
def test_a_full_disk_under_the_log(tmp_path):
    (tmp_path / "log.jsonl").symlink_to("/dev/full")
    log = RunLog(tmp_path / "log.jsonl", "a-run")
    dive = Dive(observers=[log])
    with dive.fault_between():
        pass
    log.close()
    assert log.failed == 4
    row("the log's disk is full", finish(dive), "log failures +1 a line")


def test_a_disk_that_hangs_under_an_observer():
    """Unknown is said by another thread than the one that waits for the disk."""

    class Hangs(Observer):
        hang = False

        def judged(self, *_: Any) -> None:
            if self.hang:
                self.hang = False
                dive.silence()

    slow = Hangs()
    dive = Dive(observers=[slow])
    with dive.fault_between():
        slow.hang = True
        dive.give("clear")
    row("the log's disk hangs", finish(dive), "heartbeats")


class Shifted(HandClock):
    """A clock whose time of day somebody sets."""

    by_s = 0.0

    def time(self) -> float:
        return super().time() + self.by_s


@pytest.mark.parametrize(
    ("fault", "by_s"),
    [
        ("the time of day is set back by an hour", -3600.0),
        ("the time of day is set forward by an hour", 3600.0),
    ],
)
def test_a_clock_that_is_set(fault, by_s):
    clock = Shifted()
    dive = Dive(clock=clock)
    with dive.fault_between():
        clock.by_s = by_s
    ages = [report.age_ms for report in dive.listener.reports]
    assert all(age is not None and 0 <= age < 1000 for age in ages)
    row(fault, finish(dive), "nothing")


def test_the_source_dies():
    dive = Dive()
    with dive.under_way():
        healthy(dive)
        dive.source.fail(OSError("the driver's library crashed"))
        dive.until(lambda: dive.ended)
    assert isinstance(dive.ended[0], OSError)
    said = "the loop ends with its error, and a watchdog starts it again"
    hold_row("the source fails for good", said, "restarts +1")


def texture_and(disparity: str, policy: type[Any], texture_fails: bool, warned: bool) -> Outcome:
    """A dive of two detectors of which one cannot judge the fault's frames."""
    dive = Dive()

    class Second:
        method = "disparity"

        def detect(self, frame: Frame) -> Detection:
            if what == "clear" or not faulty:
                height, width = frame.left.shape
                seen = frame.left.std() > 12 and not faulty
                return Detection(np.full((height, width), 255 * seen, np.uint8), "disparity")
            fault = Fault(Reason.STEREO, "the left and right frames do not match")
            return Detection(None, "disparity", fault=fault, vetoes_clear=warned)

    what, faulty = disparity, False
    dive.policy = policy(dive.detector, Second())

    def fails(frame: Frame) -> None:
        if texture_fails and faulty:
            raise RuntimeError("a defect")

    with dive.fault_between():
        dive.detector.before = fails
        faulty = True
        dive.give("clear" if disparity == "clear" else "fault", dive.picture("clear"))
        faulty = False
    return finish(dive)


def test_policies_where_one_detector_cannot_judge():
    alone = texture_and("fails", FallbackPolicy, texture_fails=True, warned=False)
    row("texture fails, and the pair does not fit (`fallback`)", alone, "frames by reason")
    warned = texture_and("fails", EitherPolicy, texture_fails=False, warned=True)
    row("texture sees clear water, the pair does not match (`either`)", warned, "frames by reason")
    fallen = texture_and("clear", FallbackPolicy, texture_fails=True, warned=False)
    assert ("clear", "detector_failed") in fallen.of("clear")
    row("texture fails, disparity judges (`fallback`)", fallen, "frames by reason: detector_failed")


def test_every_row_comes_from_a_test():
    found = re.findall(r"^\| (?!---|fault \|)(.*?) \|", TABLE.read_text(), re.MULTILINE)
    tests = [
        Path(__file__),
        Path(__file__).with_name("process") / "test_process_faults.py",
        Path(__file__).with_name("stereo") / "test_faint_matches.py",
        Path(__file__).with_name("stereo") / "test_disparity.py",
        Path(__file__).with_name("policy") / "test_policy.py",
    ]
    sources = "".join(path.read_text() for path in tests)
    assert [fault for fault in found if f'"{fault}"' not in sources] == []
    assert len(found) == len(set(found)) >= 25
