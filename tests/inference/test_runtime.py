import gc
import weakref

import numpy as np
import pytest

from tests.calls import run_python
from tests.inference.live import HandSource
from tests.inference.logged_runs import lines
from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.outputs.udp import UdpSender, decode
from tokt.inference.policy.assembly import assemble
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.publisher import Observer
from tokt.inference.recording.run_log import RunLog
from tokt.inference.runtime import POLL_S, LatestFrameBuffer, Runtime
from tokt.inference.sources.files import open_source
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import Detection


def logged(folder, tmp_path, detector, clock=SYSTEM_CLOCK, senders=()):
    """Run a folder's frames through a detector; the summary, and the lines of the log."""
    log = RunLog(tmp_path / "log.jsonl", "a-run", values=True)
    source = open_source(str(folder), clock)
    summary = Runtime(source, SinglePolicy(detector), senders, clock, [log]).run()
    for one in (log, *senders):
        one.close()
    return summary, lines(tmp_path / "log.jsonl")


def test_every_frame_has_a_line_whatever_happens_to_it(
    make_mission, noise_scorer, hand_clock, tmp_path
):
    folder = make_mission([[], [(4, 4)], [], [(1, 1)], []])
    (folder / "Left" / "t_L_3.jpg").write_bytes(b"\xff\xd8 not much of a picture")

    class Fragile(TextureDetector):
        def detect(self, frame: Frame) -> Detection:
            hand_clock.now += 0.02
            if frame.number == 5:
                raise RuntimeError("out of ideas")
            return super().detect(frame)

    summary, found = logged(folder, tmp_path, Fragile(noise_scorer), hand_clock)
    assert [line["status"] for line in found] == [0, 1, -1, 1, -1]
    assert [line["seq"] for line in found] == [line["frame"] for line in found] == [1, 2, 3, 4, 5]
    assert "truncated" in found[2]["health"] and "out of ideas" in found[4]["health"]
    assert found[1]["model"] == "noise/1" and found[1]["method"] == "texture"
    assert found[0]["latency_ms"] == pytest.approx(20.0)
    assert (summary.frames, summary.obstacle, summary.clear, summary.unknown) == (5, 2, 1, 2)
    assert summary.latency_ms_max == pytest.approx(20.0)


def test_datagrams_carry_what_the_log_says_and_its_decision_values_are_exact(
    make_mission, noise_scorer, receiver, tmp_path
):
    folder = make_mission([[], [(4, 4), (7, 2)]])
    senders = [UdpSender(*receiver.getsockname(), 2)]
    _, found = logged(folder, tmp_path, TextureDetector(noise_scorer), senders=senders)
    for line, frame in zip(found, open_source(str(folder), SYSTEM_CLOCK), strict=True):
        expected = noise_scorer.decision_values(frame.left)
        np.testing.assert_array_equal(line.pop("decision_values"), expected)
        heard = decode(receiver.recv(65535))
        assert {name: line[name] for name in heard} == heard


def test_a_picture_is_gone_once_the_next_ones_are_judged(make_mission, noise_scorer):
    """By itself: the garbage collector counts few objects, and comes after hundreds of frames."""

    class Watcher(Observer):
        def judged(self, frame, judgement, report):
            pictures.append(weakref.ref(frame.left))
            there.append(sum(picture() is not None for picture in pictures))

    pictures, there = [], []
    source = open_source(str(make_mission([[(1, 1)], []] * 4)), SYSTEM_CLOCK)
    policy = assemble("texture", lambda: noise_scorer, None).policy
    gc.disable()
    try:
        Runtime(source, policy, [], SYSTEM_CLOCK, [Watcher()]).run()
    finally:
        gc.enable()
    assert len(there) == 8 and max(there) <= 2


def test_a_plain_run_loads_nothing_that_it_has_no_use_for(make_mission, bundle_file):
    """After a crash each import is time in which nothing is said, and memory all along."""
    folder = make_mission([[], [(4, 4)], []])
    command = ["tokt", "run", "--bundle", str(bundle_file), "--source", str(folder)]
    unused = {
        *("numpy.ma", "numpy.random", "importlib.metadata", "sqlite3", "statistics", "secrets"),
        *("tokt.cli.train", "tokt.models.store.store", "tokt.inference.recording.log"),
        *("tokt.inference.links.link", "tokt.inference.monitoring.reload"),
    }
    program = (
        f"import sys; sys.argv = {command}\n"
        "from tokt.cli import main\n"
        f"try: main()\nexcept SystemExit: print(*{unused} & {{*sys.modules}})"
    )
    done = run_python("-c", program)
    assert "3 frames in" in done.stderr and done.stdout.split() == []


PICTURE = np.zeros((4, 4), np.uint8)


def test_only_the_newest_frame_is_kept_and_what_it_overtook_is_missed():
    source = HandSource()
    buffer = LatestFrameBuffer(source)
    for missed in (0, 0, 2, 0):
        source.give(PICTURE, missed=missed)
    until(lambda: source.passed_on == 4)
    frame = buffer.take(POLL_S)
    assert frame is not None and frame.number == 4
    assert (frame.missed, buffer.left_out) == (5, 3)  # frames 1 to 3, and the two before frame 3
    source.give(PICTURE)
    frame = buffer.take(MAX_S)
    assert frame is not None and (frame.number, frame.missed, buffer.left_out) == (5, 0, 0)
    buffer.close()


def test_the_last_frame_of_an_ended_source_is_judged():
    source = HandSource()
    source.give(PICTURE)
    source.stop()
    buffer = LatestFrameBuffer(source)
    buffer.close()
    assert not buffer.ended
    assert buffer.take(MAX_S) is not None
    assert buffer.ended and buffer.take(MAX_S) is None


def test_what_the_source_raises_reaches_the_loop_after_its_last_frame():
    source = HandSource()
    source.give(PICTURE)
    source.fail(RuntimeError("the driver is out of ideas"))
    buffer = LatestFrameBuffer(source)
    assert buffer.take(MAX_S) is not None
    with pytest.raises(RuntimeError, match="out of ideas"):
        buffer.take(MAX_S)
    buffer.close()
