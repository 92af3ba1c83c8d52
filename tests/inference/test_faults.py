"""Faults of frames, detectors, networks, disks and clocks: what is said, and never a wrong clear.

Every test puts one fault into a dive between a healthy stretch before it and one after it. What it
came to is a row of docs/reference/faults.md, and the test fails where the two differ.
"""

import json
import os
import re
import shutil
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits, OutputConfig
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.links.autopilot import mavlink_dialect
from tokt.inference.links.datagrams import DatagramSocket
from tokt.inference.links.link import open_link
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.monitoring.clock_watch import ClockWatch
from tokt.inference.monitoring.receivers import PlaceWatch, ReceiverWatch
from tokt.inference.monitoring.run_counts import RunCounts
from tokt.inference.outputs import view as view_module
from tokt.inference.outputs.listen import SenderMonitor, Silence, listen
from tokt.inference.outputs.mavlink import MavlinkSender, lens_of
from tokt.inference.outputs.udp import UdpSender
from tokt.inference.policy.assembly import assemble
from tokt.inference.policy.object_model import ObjectModel, detail_picture
from tokt.inference.policy.object_tracker import HELD, SEARCHING, ObjectTracker
from tokt.inference.policy.policy import EitherPolicy, FallbackPolicy
from tokt.inference.publisher import Observer, ReportPublisher
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording import log as log_module
from tokt.inference.recording.recorder import Recorder
from tokt.inference.recording.run_log import RunLog
from tokt.inference.report import Event
from tokt.inference.sources.files import open_source
from tokt.inference.sources.video.mjpeg import jpeg_decoder
from tokt.inference.sources.video.mpegts import TransportReader
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import Detection
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.sight import measure_sight

from ..calls import refuses
from ..fault_rows import TABLE, read_rows
from ..waiting import MAX_S, until
from .attacks import ATTACKS
from .conftest import HandClock, LevelScorer, NoiseScorer, draw, sight_of_drawn
from .dive import Dive, Outcome, healthy
from .live import BROADCAST, Sent, bound_socket, refuse
from .policy import named_object as named
from .sources.video.encoding import encode
from .sources.video.packets import transport_stream
from .still_water import dithered, flickering, jpeg, light, water, with_bit, with_clock

RNG = np.random.default_rng(7)


@pytest.fixture(autouse=True)
def same_noise(monkeypatch):
    """The same pictures whichever tests ran before."""
    monkeypatch.setitem(globals(), "RNG", np.random.default_rng(7))


def hold_row(fault: str, comes_to: str, counted: str) -> None:
    """Hold a row of three cells against the documented ones."""
    line = f"| {fault} | {comes_to} | {counted} |"
    assert line in TABLE.read_text().splitlines(), f"docs/reference/faults.md has no row\n{line}"


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


def noise(mean: float, sigma: float, *channels: int) -> np.ndarray:
    return np.clip(RNG.normal(mean, sigma, (271, 360, *channels)), 0, 255).astype(np.uint8)


def cut_off() -> np.ndarray:
    picture = draw([], 300)
    picture[200:] = 128
    return picture


def with_band(top: int, bottom: int, grey: int | None = 128) -> np.ndarray:
    """A band that fills no patch, of one colour or of the row above it."""
    picture = draw([], 300)
    picture[top:bottom] = picture[top - 1] if grey is None else grey
    return picture


FRAMES: dict[str, tuple[Reason, Callable[[], np.ndarray] | None]] = {
    "lens covered, lamp out: a dark frame": (Reason.DARK, lambda: noise(2, 1)),
    "glare: a saturated frame": (Reason.SATURATED, lambda: noise(254, 3)),
    "a frame of one grey": (Reason.BLANK, lambda: np.full((271, 360), 90, np.uint8)),
    "the end of a frame zeroed or gray": (Reason.DAMAGED, cut_off),
    "noise instead of a picture: a covered lens": (Reason.BLANK, lambda: noise(12, 4)),
    "noise instead of a picture: snow in colour": (Reason.BLANK, lambda: noise(128, 40, 3)),
    "haze that leaves a fraction of a grey level": (
        Reason.BLANK,
        lambda: cv2.convertScaleAbs(draw([], 300), alpha=0.1, beta=100),
    ),
    "a grey band, a lost packet: in mid-frame": (Reason.DAMAGED, lambda: with_band(115, 155)),
    "a grey band, a lost packet: at the bottom": (Reason.DAMAGED, lambda: with_band(247, 271, 60)),
    "rows that repeat the row above: a lost packet, concealed": (
        Reason.DAMAGED,
        lambda: with_band(90, 120, None),
    ),
    "a frame under 240 pixels wide, or of no camera's shape": (
        Reason.WRONG_SIZE,
        lambda: noise(60, 9)[:200, :200],
    ),
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
    dive = Dive(scorer=NoiseScorer(sight=sight_of_drawn()))
    with dive.fault_between():
        if picture is None:
            dive.fault(Fault(reason, "no picture"))
        else:
            dive.give("fault", picture())
    kind = fault.partition(": ")[0] if picture else fault
    row(kind, finish(dive), "frames by reason")


def with_a_datagram_lost(dive: Dive) -> None:
    """Give what is said of MPEG-TS from a lost datagram to the next key picture."""
    packets = [packet.data for packet in transport_stream(encode(frames=60, key_every=15))]
    reader = TransportReader()
    readings = [done for data in packets[:40] + packets[41:] for done in reader.datagram(data, 0.0)]
    first = next(place for place, reading in enumerate(readings) if not reading.fault)
    for reading in readings[first:]:
        if reading.fault:
            dive.fault(reading.fault)


def of_a_jpeg_with_a_hole(dive: Dive) -> None:
    data = cv2.imencode(".jpg", noise(60, 9))[1].tobytes()
    with jpeg_decoder() as decode:
        dive.fault(decode(data[:9000] + data[9900:])[1])


class ColourDive(Dive):
    """The same in yellow."""

    def picture(self, what):
        """Less blue than green and red."""
        gray = super().picture(what)
        return cv2.merge([gray // 2, gray, gray])


def test_a_gray_frame_for_a_model_that_looks_at_colours():
    dive = ColourDive(scorer=NoiseScorer(needs_colour=True))
    with dive.fault_between():
        dive.give("fault", cv2.merge([draw([], 300)] * 3))
    row(
        "a gray frame, or a colour one without colour, for a model that looks at colours",
        finish(dive),
        "frames by reason: no_colour +1",
    )


class Learnt(NoiseScorer):
    """The same with landmarks: all that it knows is as even as open water."""

    @property
    def map(self):
        """Itself."""
        return self

    def distance(self, features):
        """How far from even."""
        return np.abs(features[:, 0] - 1.9)


def test_a_patch_unlike_all_that_was_learnt():
    """Too even for an obstacle, and unlike water."""
    scorer = Learnt(operating_point=OperatingPoint(unlike=0.9))
    dive = Dive(scorer=scorer)
    with dive.fault_between():
        cloth = draw([], 300).astype(np.float64)
        cloth[60:120, 90:200] += RNG.normal(0, 3, (60, 110))
        dive.give("fault", cloth.astype(np.uint8))
    row(
        "a thing that a model never learnt, clear to it", finish(dive), "frames by reason: novel +1"
    )


UNLIKE_TRAINING = {
    "haze over a model's frames": "haze 0.5",
    "glow from below over a model's frames": "glow",
    "black is white, of a model's frames": "inverted",
}


@pytest.mark.parametrize("fault", UNLIKE_TRAINING)
def test_a_picture_that_is_unlike_all_that_the_model_learnt_from(fault):
    dive = Dive(scorer=LevelScorer([draw([], seed) for seed in range(8)]))
    with dive.fault_between():
        dive.give("fault", ATTACKS[UNLIKE_TRAINING[fault]](draw([], 300)))
    what = "haze, a glow from below, or black for white, over a model's frames"
    row(what, finish(dive), "frames by reason: drift +1")


def test_a_picture_without_the_fine_detail_that_the_model_learnt_from():
    sharp = [draw([], seed) + RNG.integers(0, 3, (271, 360), np.uint8) for seed in range(8)]
    scorer = LevelScorer(sharp, typical=1.0)  # its features may be anything
    scorer.sight = measure_sight(sharp)
    detector = TextureDetector(scorer)
    fewer = {
        "blurred: water on the lens, a picture made smooth": cv2.GaussianBlur(sharp[2], (0, 0), 2),
        "enlarged: a digital zoom": cv2.resize(sharp[2], None, fx=2, fy=2)[100:371, 36:396],
    }
    assert not detector.detect(Frame(1, 0.0, sharp[3], None)).mask.any()
    for fault, picture in fewer.items():
        found = detector.detect(Frame(2, 0.0, picture, None))
        assert found.mask is None and found.vetoes_clear and "not seen" in found.fault
        hold_row(fault, f"unknown `{found.fault.reason}`", "frames by reason")
    # What is seen all the same is an obstacle.
    picture = cv2.GaussianBlur(draw([(4, 4)], 5), (0, 0), 2)
    assert detector.detect(Frame(3, 0.0, picture, None)).mask.any()


def test_a_cloud_of_sediment():
    """It is bright, and the water's fine blocks fade in it."""
    dive = Dive()
    dive.policy = assemble("texture", NoiseScorer, None).policy
    away = np.hypot(*(np.mgrid[:271, :360] / 360 - 0.4))
    cloud = np.exp(-((2 * away) ** 2))
    with dive.under_way():
        for _ in range(10):
            dive.give("clear")
        for _ in range(5):
            dive.give(
                "fault", (dive.picture("clear") * (1 - 0.8 * cloud) + 60 * cloud).astype("u1")
            )
        for _ in range(2):
            dive.give("the last of it", dive.picture("clear"))
        healthy(dive)
    row("a cloud of sediment, with nothing seen in it", finish(dive), "frames by reason: sediment")


def test_a_named_object_that_is_gone_or_in_a_picture_that_froze():
    dive, policy = Dive(), assemble("texture", NoiseScorer, None).policy
    policy.tracker = ObjectTracker(
        ObjectModel(detail_picture(named.picture(named.own())), named.SHARES)
    )
    dive.policy = policy

    def see(frame: np.ndarray) -> tuple[str | None, bool]:
        dive.give("fault", frame)
        verdict = dive.listener.reports[-1].verdict
        errors = {verdict.anchor_x, verdict.anchor_y, verdict.anchor_size}
        return verdict.anchor, errors == {None}

    with dive.under_way():
        for seed in range(1, 9):
            seen = named.picture(named.own(), seed=seed)
            last = see(seen)
        assert last == (HELD, False)
        dive.clock.now += 1.25 * dive.limits.stale_s
        said = {see(seen.copy()), see(seen.copy())}
        reasons = [report.verdict.reason for report in dive.listener.reports[-2:]]
        assert reasons == [Reason.STALE, Reason.FROZEN]
        found = [see(named.picture(named.own(), seed=seed)) for seed in (9, 12, 13)]
        assert found[-1] == (HELD, False)
        said |= {see(named.picture(seed=10)), see(named.picture(named.twin(180), seed=11))}
    assert said == {(SEARCHING, True)}
    fault = "a named object out of view, or another of its make in its place, or a frozen camera"
    hold_row(fault, "`anchor` searching, its errors null", "nothing")


def test_a_frame_that_is_not_believed_is_not_known_to_the_frame_rule_either():
    scorer = LevelScorer([draw([], seed) for seed in range(8)])
    scorer.operating_point = OperatingPoint(MofNRule(m=3, n=5))
    hazy = ATTACKS["haze 0.5"](draw([], 300))
    pictures = [draw([], seed) for seed in range(9, 14)] + [hazy] * 3 + [draw([(4, 5)], 14)]
    detector = TextureDetector(scorer)
    found = [detector.detect(Frame(number, 0.0, one, None)) for number, one in enumerate(pictures)]
    assert [one.fault.reason for one in found[4:8]] == [Reason.OK] + [Reason.DRIFT] * 3
    assert found[8].mask is None and found[8].vetoes_clear
    hold_row(
        "haze while something comes into view, then none",
        f"unknown `drift`, then unknown `{found[8].fault.reason}`",
        "frames by reason",
    )


def few_bits_video(folder: Path) -> None:
    codec, options = cv2.VideoWriter.fourcc(*"FFV1"), [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U]
    options += [cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    path = str(folder / "dive.mkv")
    writer = cv2.VideoWriter(path, cv2.CAP_FFMPEG, codec, 10.0, (360, 272), options)
    writer.write(np.pad(noise(60, 9), ((0, 1), (0, 0))).astype(np.uint16) * 16)
    writer.release()


def few_levels_pgm(folder: Path) -> None:
    (folder / "1.pgm").write_bytes(b"P5\n360 271\n127\n" + (noise(60, 9) // 2).tobytes())


DEEP: dict[str, Callable[[Path], object]] = {
    "12-bit levels in a 16-bit image": lambda folder: cv2.imwrite(
        str(folder / "1.png"), noise(60, 9).astype(np.uint16) * 16
    ),
    "12-bit levels in a 16-bit video": few_bits_video,
    "a PGM whose brightest level is not 255": few_levels_pgm,
    "an image of floating-point numbers": lambda folder: cv2.imwrite(
        str(folder / "1.tif"), noise(60, 9).astype(np.float32)
    ),
}


@pytest.mark.parametrize("fault", DEEP)
def test_a_file_that_would_be_nearly_black(tmp_path, fault):
    DEEP[fault](tmp_path)
    name = str(tmp_path / "dive.mkv") if "video" in fault else str(tmp_path)
    dive = Dive()
    (frame,) = open_source(name, dive.clock)
    assert "; convert it to 8 bits" in frame.left_fault
    with dive.fault_between():
        dive.fault(frame.left_fault)
    outcome = finish(dive)
    what = "12-bit levels in a 16-bit image or video, a PGM of other levels, floating-point numbers"
    row(what, outcome, f"frames by reason: unreadable +{outcome.summary.reasons['unreadable']}")


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


STILL = light(40, 20, 271, 360)


FROZEN: dict[str, Callable[[list[np.ndarray], int], np.ndarray]] = {
    "a camera's buffers go round: two pictures by turns": lambda seen, n: seen[-1 - n % 2],
    "a camera's buffers go round: four pictures": lambda seen, n: seen[-1 - -n % 4],
    "a camera's buffers go round: four pictures, each compressed anew": lambda seen, n: jpeg(
        seen[-1 - -n % 4], 98 - 2 * n
    ),
    "a frozen camera, a little changed: a bit": lambda seen, n: with_bit(seen[-1], n),
    "a frozen camera, a little changed: a clock in the corner": lambda seen, n: with_clock(
        seen[-1], n
    ),
    "a frozen camera, a little changed: by compression": lambda seen, n: jpeg(seen[-1], 98 - 2 * n),
    "a frozen camera, a little changed: by noise of a grey level": lambda seen, n: dithered(
        seen[-1]
    ),
    "a frozen camera, a little changed: light by 1 %": lambda seen, n: flickering(seen[-1], n),
    "a frozen camera, a little changed: it rolls": lambda seen, n: np.roll(seen[-1], n, n % 2),
    "a part of the picture is frozen: half of it": lambda seen, n: np.vstack(
        [water(STILL)[:135], seen[-1][135:]]
    ),
    "a part of the picture is frozen: a row of patches": lambda seen, n: np.vstack(
        [water(STILL)[:108], seen[-1][108:135], water(STILL)[135:]]
    ),
}


@pytest.mark.parametrize("fault", FROZEN)
def test_a_camera_that_gives_what_it_gave_before(fault):
    dive = Dive()
    seen = [water(STILL) for _ in range(4)]
    with dive.fault_between():
        for picture in seen:
            dive.give("clear", picture)
        for number in range(1, 6):
            dive.give("fault", FROZEN[fault](seen, number))
    outcome = finish(dive)
    reasons = outcome.summary.reasons
    what = "a camera's buffers go round, or its picture is frozen in part, or a little changed"
    row(what, outcome, f"frames by reason: frozen +{reasons[Reason.FROZEN]}")


def too_old(dive: Dive) -> None:
    dive.give("fault", dive.picture("clear"), age_s=0.3)


def silent(dive: Dive) -> None:
    dive.silence()
    dive.silence()


def raising(dive: Dive) -> None:
    def fails(frame: Frame) -> None:
        raise MemoryError("out of memory")

    dive.detector.before = fails
    dive.give("fault", dive.picture("clear"))


def not_a_number(dive: Dive) -> None:
    dive.scorer.values_of = lambda features: features * np.nan
    dive.give("fault", dive.picture("clear"))
    del dive.scorer.values_of


def hanging(what: str) -> Callable[[Dive], None]:
    def hang(dive: Dive) -> None:
        dive.detector.before = lambda frame: dive.silence()
        dive.give("fault", dive.picture(what))

    return hang


def suspend(dive: Dive) -> None:
    """The computer stands still for 5 s; then what is said first is that nothing was."""
    with dive.something_said():
        dive.clock.suspend(5.0)


def suspended(what: str) -> Callable[[Dive], None]:
    def happens(dive: Dive) -> None:
        dive.detector.before = lambda frame: suspend(dive)
        dive.give("fault", dive.picture(what))
        dive.detector.before = lambda frame: None
        dive.give("fault", dive.picture("clear"))  # it may have been taken before
        dive.silence()

    return happens


def frozen_or_black(dive: Dive) -> None:
    seen = water(STILL)
    dive.give("clear", seen)
    for _ in range(3):
        dive.give("fault", np.zeros_like(seen))
        dive.give("fault", seen)


LATE = "frames by reason: late +1; heartbeats"
AND_STALE = "frames by reason: late +1, stale; heartbeats"
BETWEEN: dict[str, tuple[Callable[[Dive], None], str]] = {
    "a frame older than `--stale` when it comes": (too_old, "frames by reason: stale +1"),
    "frames stop coming": (silent, "heartbeats"),
    "a detector raises": (raising, "frames by reason: detector_failed +1"),
    "a decision value is NaN": (not_a_number, "frames by reason: not_finite +1"),
    "a detector takes too long: what it then calls clear": (hanging("clear"), LATE),
    "a detector takes too long: what it then calls an obstacle": (hanging("obstacle"), LATE),
    "a frozen camera: every other frame is black": (
        frozen_or_black,
        "frames by reason: dark +1, frozen +5",
    ),
    "a datagram of network video is lost: no picture up to the next key picture": (
        with_a_datagram_lost,
        "frames by reason: incomplete +1, damaged",
    ),
    "a JPEG of a stream or a USB camera of which a part is missing": (
        of_a_jpeg_with_a_hole,
        "frames by reason: incomplete +1",
    ),
    "the computer is suspended while a clear frame is judged": (suspended("clear"), AND_STALE),
    "the computer is suspended while an obstacle is judged": (suspended("obstacle"), AND_STALE),
}


@pytest.mark.parametrize("fault", BETWEEN)
def test_between_two_healthy_stretches(fault):
    happens, counted = BETWEEN[fault]
    dive = Dive()
    with dive.fault_between():
        happens(dive)
        dive.detector.before = lambda frame: None
    row(fault, finish(dive), counted)


def test_no_frame_from_the_start():
    dive = Dive()
    with dive.under_way():
        silent(dive)
        healthy(dive)
    row("no frame since the start", finish(dive), "heartbeats")


def test_frames_faster_than_they_are_judged():
    dive = Dive(limits=Limits(5, 5))
    go = threading.Event()
    with dive.fault_between():
        dive.detector.before = lambda frame: go.wait(MAX_S) and None
        judged = len(dive.listener.reports)
        dive.give_at_once("clear")
        dive.until(lambda: dive.detector.judging)
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


def test_localhost_is_where_labview_listens(monkeypatch):
    real = socket.getaddrinfo

    def both(host: str, port: int, **more: Any) -> Any:
        found = real("127.0.0.1", port, **more)
        return real("::1", port, **more) + found if host == "localhost" else found

    with bound_socket() as labview:
        port = labview.getsockname()[1]
        monkeypatch.setattr(socket, "getaddrinfo", both)
        sender = UdpSender("localhost", port, 2)
        dive = Dive(senders=[sender])
        with dive.under_way():
            healthy(dive)
        assert [labview.recv(4096)[:5] for _ in range(sender.sent)] == [b'{"v":'] * 2
        sender.close()
    # So does tokt listen.
    watch = SenderMonitor(0.0, None)

    def heard() -> None:
        sender = DatagramSocket("127.0.0.1", port)
        sender.write(b"hello")
        sender.close()

    came = next(listen("localhost", port, watch, HandClock(), lambda: False, heard))
    assert not isinstance(came, Silence) and came.fields["bytes"] == 5
    row("a receiver `localhost` that is ::1 first", finish(dive), "sent")


def test_a_broadcast_address():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as anybody:
        anybody.bind(("0.0.0.0", 0))
        anybody.settimeout(MAX_S)
        sender = UdpSender(BROADCAST, anybody.getsockname()[1], 2)
        dive = Dive(senders=[sender])
        with dive.under_way():
            healthy(dive)
        assert (sender.sent, sender.failed) == (2, 0)
        assert [anybody.recv(4096)[:5] for _ in range(2)] == [b'{"v":'] * 2
        sender.close()
    row("a receiver that is a broadcast address", finish(dive), "sent")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "fe80::1"])
def test_an_address_that_is_no_receiver_s(host):
    refuses(host, UdpSender, host, 1130, 2)
    refuses(host, open_link, f"udpout:[{host}]:14550")
    said = "one line at the start, exit code 2"
    hold_row("a receiver 0.0.0.0, or link-local without its network", said, "nothing")


def mavlink_dive(address: str) -> tuple[Dive, MavlinkSender]:
    """A dive of which a link is told."""
    pytest.importorskip("pymavlink")
    dive = Dive()
    known, tell = VehicleState(dive.clock), dive.events.put
    lens, wanted = lens_of(60, None), OutputConfig()
    sender = MavlinkSender(open_link(address), lens, wanted, dive.clock, known, tell)
    dive.senders = [sender]
    return dive, sender


@contextmanager
def over_tcp() -> Iterator[tuple[Dive, MavlinkSender, socket.socket]]:
    """Give a dive that is under way, its sender over TCP, and that link's other end."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(MAX_S)
        dive, sender = mavlink_dive(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        channel, _ = server.accept()
        with channel, dive.fault_between():
            yield dive, sender, channel
        sender.close()


def test_a_mavlink_link_whose_other_end_does_not_read():
    with over_tcp() as (dive, sender, _):
        # Whoever waited for the other end would wait for ever.
        until(lambda: [sender._to.write(bytes(1000)) for _ in range(100)] and sender.failed)
    row("a MAVLink link over TCP whose other end does not read", finish(dive), "sent, then failed")


def test_a_mavlink_link_whose_other_end_sends_garbage():
    with over_tcp() as (dive, sender, channel):
        for garbage in (bytes(9000), b"\xfd" * 9000, RNG.bytes(9000)):
            channel.sendall(garbage)
            dive.give("clear")
    assert sender.sent > 0
    row("a MAVLink link whose other end sends garbage", finish(dive), "sent")


def test_a_mavlink_link_without_anybody():
    with bound_socket() as freed:
        port = freed.getsockname()[1]
    dive, sender = mavlink_dive(f"udpin:127.0.0.1:{port}")
    watch = ReceiverWatch({"station": sender}, dive.clock, dive.events.put)
    dive.observers.append(watch)
    with dive.fault_between(), bound_socket() as station:
        for _ in range(9):
            dive.clock.now += 0.15  # less than what a heartbeat breaks
            dive.give("clear")
        beat = mavlink_dialect().MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        station.sendto(beat.pack(mavlink_dialect().MAVLink(None, 255, 190)), ("127.0.0.1", port))
        until(lambda: [dive.give("clear")] and sender.sent)
    sender.close()
    outcome = finish(dive)
    names = [event.name for event in outcome.events]
    assert names == ["receiver_refused", "receiver_back"] and "nobody is heard" in sender.last_error
    counted = "failed; events `receiver_refused`, `receiver_back`"
    row("a MAVLink link without anybody at its other end", outcome, counted)


def test_an_autopilot_that_falls_silent():
    clock, sent, told = HandClock(), Sent(), []
    state = VehicleState(clock)
    publisher = ReportPublisher([sent], clock, Limits(), live=True, place=state.place)
    watch = PlaceWatch(clock, told.append, lambda: "the port is gone")
    for depth_m in (31.4, *[None] * 5, 31.5, 31.6, None):
        clock.now += 1.25
        if depth_m is not None:
            state.put(depth_m=depth_m)
        publisher.heartbeat()
        watch.heartbeat(sent.reports[-1])
    places = [report.place.depth_m for report in sent.reports]
    assert places == [31.4, 31.4, *[None] * 4, 31.5, 31.6, 31.6]
    assert [(event.name, event.words) for event in told] == [
        ("place_lost", "the vehicle's place is not known: the port is gone"),
        ("place_back", "the vehicle's place is known again"),
    ]
    counted = "events `place_lost`, `place_back`"
    hold_row("the autopilot falls silent", "as without it; after 2 s no place", counted)


def test_a_name_that_nobody_knows():
    refuses("cannot be found", UdpSender, "no-such-host.invalid", 1130, 1)
    said = "one line at the start, exit code 2"
    hold_row("a receiver's name that nobody knows at the start", said, "nothing")


def test_listening_to_a_group():
    never = listen("239.1.1.1", 1130, SenderMonitor(0.0, None), HandClock(), lambda: True, list)
    refuses("multicast group", lambda: next(never))


def test_a_receiver_that_is_refused_for_a_while():
    """What the system does when a cable is out; told while it lasts, not only at the end."""
    clock = HandClock()
    sender = UdpSender(BROADCAST, 9, 2)
    counts, told = RunCounts(clock), []
    watch = ReceiverWatch({"bridge:9": sender}, clock, lambda event: told.append(event.name))
    dive = Dive(clock=clock, senders=[sender], observers=[counts, watch])
    watch._tell_event = lambda event: (told.append(event.name), dive.events.put(event))
    with dive.fault_between():
        refuse(sender)
        dive.give("clear")
        dive.give("clear")
        assert told == []  # one datagram is no receiver
        clock.now += 1.0
        dive.give("clear")
        assert told == ["receiver_refused"]
        dive.give("clear")
        assert list(counts.warnings.values()) == [
            "nothing can be sent to bridge:9: Permission denied"
        ]
        refuse(sender, refused=False)
        # Where the clock jumps, unknown may be said before the frame is judged.
        beats = len(dive.listener.heartbeats)
    assert told == ["receiver_refused", "receiver_back"] and sender.failed == 4 + beats
    sender.close()
    outcome = finish(dive)
    assert [event.name for event in outcome.events] == told
    outcome.said = [one for one in outcome.said if one[0] != "-"]
    counted = "failed; events `receiver_refused`, `receiver_back`"
    row("a receiver that the system refuses for 1 s or longer", outcome, counted)


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


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a pipe with a name")
def test_a_disk_that_hangs_under_the_log(tmp_path, monkeypatch):
    monkeypatch.setattr(log_module, "_MAX_WAITING", 20)
    monkeypatch.setattr(log_module, "_PATIENCE_S", 0.1)
    os.mkfifo(tmp_path / "log.jsonl")  # to open it takes until there is a reader
    log = RunLog(tmp_path / "log.jsonl", "a-run", live=True)
    dive = Dive(observers=[log])
    with dive.fault_between():
        for _ in range(20):
            dive.give("clear")
    assert log.failed == 4
    with (tmp_path / "log.jsonl").open("rb") as disk:  # it is back
        written = [json.loads(disk.readline()) for _ in range(20)]
        assert [line["seq"] for line in written] == list(range(1, 21))
        log.heartbeat(dive.listener.reports[-1])
        assert json.loads(disk.readline()) == {"lost_lines": 4, "why": "the disk hangs"}
        assert json.loads(disk.readline())["seq"] == 24
        monkeypatch.setattr(log_module, "_PATIENCE_S", MAX_S)
        log.close()
        assert log.failed == 4 and disk.read() == b""
    row("the log's disk hangs", finish(dive), "log failures +1 a line, after 1000")


def cut_short(path: Path) -> None:
    path.write_bytes(b"")


def replace_file(path: Path) -> None:
    (path.parent / "other").write_text("")
    (path.parent / "other").replace(path)


LOST_FILES = {
    "the log's file is deleted": ("log.jsonl", Path.unlink, 2),
    "the log's events are deleted": ("log.events.jsonl", Path.unlink, 1),
    "the log's file is replaced": ("log.jsonl", replace_file, 2),
    "the log's file is cut short": ("log.jsonl", cut_short, 2),
    "the log's file is given another name": (
        "log.jsonl",
        lambda path: path.rename(path.with_name("old.jsonl")),
        0,
    ),
    "the log's folder is deleted": ("", shutil.rmtree, 3),
}


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("fault", LOST_FILES)
def test_a_log_whose_file_is_taken_away_is_begun_anew(fault, live, tmp_path):
    name, take_away, lost = LOST_FILES[fault]
    folder, told = tmp_path / "logs", []
    folder.mkdir()
    log = RunLog(folder / "log.jsonl", "a-run", live=live, tell=told.append)
    log.event(Event(1.0, "start", "it begins"))
    dive = Dive(observers=[log])
    with dive.fault_between():
        written = [folder / "log.jsonl", folder / "log.events.jsonl"]
        lines = [path.read_text().splitlines() for path in written]
        assert [len(each) for each in lines] == [2, 1]
        take_away(folder / name)
        until(lambda: not live or told)  # live it is noticed though nothing is written
    log.event(Event(2.0, "drift", "something else"))
    outcome = finish(dive)
    log.close()
    assert {event.name for event in told} == {"log_lost"} and log.failed == lost
    frames, events = ([json.loads(line) for line in path.open()] for path in written)
    known = [line["seq"] for line in frames if "seq" in line]
    assert known == ([1, 2, 3, 4] if lost == 1 else [3, 4])
    counts = [line["lost_lines"] for line in (*frames, *events) if "lost_lines" in line]
    assert sum(counts) == lost
    assert [line["event"] for line in events if "event" in line] == ["start", "drift"]
    row(fault, outcome, f"log failures +{lost}; event `log_lost`")


def test_a_recording_whose_folder_is_deleted_begins_anew(tmp_path):
    folder, told = tmp_path / "rec", []
    recorder = Recorder(folder, "a-run", SYSTEM_CLOCK, 0, 0, 100.0, 0.0, tell=told.append)
    dive = Dive(observers=[recorder])
    with dive.fault_between():
        until(lambda: recorder.writer.frames)
        shutil.rmtree(folder)
        until(lambda: (folder / ".recording.lock").exists())  # though nothing is recorded
    outcome = finish(dive)
    recorder.close()
    assert list(folder.glob("a-run/Left/*.png"))
    assert any("was taken away and restarted" in event.words for event in told)
    row("the recording's folder is deleted", outcome, "event `recording` with the frames gone")


def test_an_observer_that_hangs():
    """Unknown is said by another thread than the one that waits."""

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
    row("what looks on takes too long", finish(dive), "heartbeats")


VIEWS = {
    "the live view's process is killed": "SIGKILL",
    "the live view's process hangs": "SIGSTOP",
    "clients of the live view that never read": "",
}


@pytest.mark.skipif(os.name != "posix", reason="POSIX signals")
@pytest.mark.parametrize("fault", VIEWS)
def test_a_live_view_that_fails(fault, monkeypatch):
    if VIEWS[fault]:
        monkeypatch.setattr(view_module, "ANSWER_S", 0.5)
    told: list[Event] = []
    listener = view_module.listening("127.0.0.1", 0)
    view = view_module.LiveView(listener, None, None, 0.5, told.append, None)
    dive = Dive(observers=[view])
    with dive.fault_between(), ExitStack() as clients:
        dive.until(lambda: view._process is not None and not view._newest)
        assert view._process is not None and view._process.pid is not None
        if VIEWS[fault]:
            os.kill(view._process.pid, getattr(signal, VIEWS[fault]))
        else:
            for _ in range(5):
                client = clients.enter_context(socket.create_connection(listener.getsockname()))
                host, port = listener.getsockname()
                client.sendall(
                    b"GET /stream.mjpg HTTP/1.0\r\nHost: %b:%d\r\n\r\n" % (host.encode(), port)
                )
        for _ in range(60 if VIEWS[fault] else 20):
            dive.give("clear")
            if told:
                break
            time.sleep(0.5 if VIEWS[fault] else 0.01)
    view.close()
    counted = "event `view_lost`" if VIEWS[fault] else "nothing"
    assert [event.name for event in told] == ["view_lost"] * bool(VIEWS[fault])
    row(fault, finish(dive), counted)


def test_a_suspend_while_a_frame_waits():
    dive = Dive()
    go = threading.Event()
    with dive.fault_between():
        judged = len(dive.listener.reports)
        dive.detector.before = lambda frame: go.wait(MAX_S) and None
        dive.give_at_once("fault")
        dive.until(lambda: dive.detector.judging)
        dive.give_at_once("fault")
        dive.pass_on()
        suspend(dive)
        go.set()
        dive.until(lambda: len(dive.listener.reports) == judged + 2)
        dive.detector.before = lambda frame: None
        dive.silence()
    outcome = finish(dive)
    assert all(report.age_ms > 4999 for report in dive.listener.reports[judged:][:2])
    row(
        "the computer is suspended while a frame waits to be judged",
        outcome,
        "frames by reason: late +1, stale +1; heartbeats",
    )


def test_a_suspend_while_frames_are_in_a_driver():
    """They are handed over afterwards, as if they were new."""
    dive = Dive()
    with dive.fault_between():
        suspend(dive)
        for _ in range(4):
            dive.give("fault", dive.picture("clear"))
        dive.silence()
        dive.give("fault", dive.picture("clear"))  # it may be as old as the silence was long
        healthy(dive)
        dive.clock.suspend(0.01)  # what may come between two looks at two clocks is none
    outcome = finish(dive)
    assert outcome.summary.reasons["stale"] == 5
    fault = "the computer is suspended: frames that a driver's buffers held"
    row(fault, outcome, "frames by reason: stale; heartbeats")


@pytest.mark.parametrize(("stalled_s", "held_up"), [(0.5, 3), (1.0, 8), (6.0, 1), (6.0, 50)])
def test_a_stall_after_which_what_was_on_its_way_comes(stalled_s, held_up):
    dive = Dive()
    with dive.fault_between():
        for _ in range(8):
            dive.clock.now += 0.1
            dive.give("clear")
        dive.clock.now += stalled_s
        for _ in range(held_up):  # as fast as the network can
            dive.clock.now += 0.005
            dive.give("fault", dive.picture("clear"))
        dive.clock.now += 0.02
        dive.give("fault", dive.picture("obstacle"))
        dive.clock.now += 0.1
    outcome = finish(dive)
    assert outcome.summary.reasons["stale"] == held_up + 1
    fault = "the network stalls, and what was on its way comes late, as if it were new"
    row(fault, outcome, "frames by reason: stale; heartbeats")


def test_a_suspend_within_the_frames_of_the_frame_rule():
    dive = Dive(scorer=NoiseScorer(operating_point=OperatingPoint(MofNRule(0, 1, 2, 3))))
    with dive.under_way():
        for _ in range(3):
            dive.give("clear")
        suspend(dive)
        dive.give("fault", dive.picture("clear"))
        dive.silence()
        dive.give("fault", dive.picture("obstacle"))
        dive.give("obstacle")
    outcome = dive.outcome()
    assert outcome.said[-1] == ("obstacle", "obstacle", "ok")
    outcome.said = outcome.said[-2:-1]
    fault = "the computer is suspended between the frames that the frame rule needs"
    row(fault, outcome, "frames by reason: frame_rule")


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
    dive.observers.append(ClockWatch(clock, dive.events.put))
    with dive.fault_between():
        clock.by_s = by_s
    ages = [report.age_ms for report in dive.listener.reports]
    assert all(age is not None and 0 <= age < 1000 for age in ages)
    outcome = finish(dive)
    (event,) = outcome.events
    assert (event.name, event.fields["by_s"]) == ("clock_set", by_s)
    row(fault, outcome, "event `clock_set`")


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
    found = [each.fault for each in read_rows()]
    written = (path.read_text("utf-8") for path in Path(__file__).parents[1].rglob("test_*.py"))
    sources = "".join(source for source in written if "hold_row" in source)
    # What stands behind a colon there tells variants of one fault apart.
    unknown = [fault for fault in found if not re.search(f'"{re.escape(fault)}[":]', sources)]
    assert unknown == []
    assert len(found) == len(set(found)) >= 60
