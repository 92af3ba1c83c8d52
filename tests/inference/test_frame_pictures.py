"""The pictures of a frame: made once for all who look at it, whatever the threads."""

import pickle
from dataclasses import replace
from threading import Barrier, Thread

import numpy as np
import pytest

from tests.inference.swimming import Told
from tokt.features.common.errors import ToktError
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.view_mask import CameraMasks, ViewMask
from tokt.features.kernels.dispatch import Kernels
from tokt.features.kernels.quantization import Quantization
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.monitoring.fixed_marks_watch import FixedMarksWatch
from tokt.inference.policy.moving import MovingThings
from tokt.inference.policy.object_model import ObjectModel, detail_picture
from tokt.inference.policy.object_tracker import ObjectTracker
from tokt.inference.report import Report
from tokt.inference.verdict import CLEAR

IMAGE = Quantization(gain=8, levels=64, smooth=3, window=31, by="frame")


def some_frame(seed=1, height=240, width=400):
    picture = np.random.default_rng(seed).integers(30, 90, (height, width, 3), np.uint8)
    return Frame(1, 0.0, picture, None)


@pytest.fixture
def passes(monkeypatch):
    """The sizes of the gray pictures that were made by going over a frame."""
    made = []
    for name in ("resized_gray", "resized_gray16", "resized_grays"):
        own = getattr(Kernels, name)

        def noting(kernels, frame, *size_and_threads, own=own):
            made.append(size_and_threads[:2])
            return own(kernels, frame, *size_and_threads)

        monkeypatch.setattr(Kernels, name, noting)
    return made


def test_a_picture_is_made_once_for_equal_sizes_and_lasts_as_long_as_its_array(passes):
    frame = some_frame()
    first = frame.pictures("left", DEFAULT_GRID)
    others = Grid(5, 5, DEFAULT_GRID.width)
    assert frame.pictures("left", others).gray16 is first.gray16
    assert replace(frame, missed=3).pictures("left", others).picture(IMAGE) is first.picture(IMAGE)
    assert first.rounded is frame.pictures("left", others).rounded
    assert len(passes) == 1
    assert frame.pictures("left", Grid(5, 5, 180)).gray16.shape != first.gray16.shape
    other = replace(frame, left=frame.left.copy())
    assert other.pictures("left", DEFAULT_GRID).gray16 is not first.gray16
    assert len(passes) == 3


def test_what_is_covered_has_pictures_of_its_own():
    mask = ViewMask.of_picture(np.pad(np.full((120, 200), 255, np.uint8), ((0, 120), (0, 200))))
    frame = replace(some_frame(), masks=CameraMasks(mask))
    plain, covered = (each.pictures("left", DEFAULT_GRID).gray16 for each in (frame, frame.covered))
    assert frame.covered is frame.covered
    assert not np.array_equal(plain, covered)


def test_both_gray_pictures_are_those_made_alone():
    frame = some_frame()
    both = frame.pictures("left", DEFAULT_GRID)
    both.prepare((None, IMAGE))
    alone = FramePictures(frame.left, DEFAULT_GRID)
    assert np.array_equal(both.picture(None), alone.picture(None))
    assert np.array_equal(both.gray16, alone.gray16)
    assert np.array_equal(both.rounded, np.floor(alone.gray16 / 256 + 0.5))


def test_a_named_object_looks_at_the_frames_own_picture(passes):
    frame = some_frame()
    tracker = ObjectTracker(ObjectModel(detail_picture(frame.left), (0.3, 0.3, 0.3, 0.3)))
    size = frame.pictures("left", DEFAULT_GRID).gray16.shape
    passes.clear()
    tracker.look(frame.left, shared=frame.shared)
    assert size not in passes
    tracker.look(frame.left)
    assert passes.count(size) == 1


def test_of_several_threads_one_makes_a_picture_and_the_others_wait(passes):
    frame, start, got = some_frame(height=900, width=1200), Barrier(4), []

    def look():
        start.wait()
        got.append(frame.pictures("left", DEFAULT_GRID).gray16)

    threads = [Thread(target=look) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(passes) == 1 and all(each is got[0] for each in got)


def test_a_frame_for_another_process_leaves_its_pictures_behind():
    frame = some_frame()
    gray16 = frame.pictures("left", DEFAULT_GRID).gray16
    data = pickle.dumps(frame)
    assert len(data) < frame.left.nbytes + 1000
    theirs = pickle.loads(data).pictures("left", DEFAULT_GRID).gray16
    assert np.array_equal(theirs, gray16)


@pytest.mark.parametrize("shape", [(1, 3000), (1, 1, 3), (40, 30_000), (60_000, 40), (0, 9), (9,)])
def test_a_strip_has_no_small_picture_and_stops_nothing(shape):
    strip = Frame(1, 0.0, np.zeros(shape, np.uint8), None)
    gray = strip.small_gray("left")
    assert gray is None or gray.shape == (DEFAULT_GRID.width, DEFAULT_GRID.width)
    judgement = MovingThings(Told()).judge(strip)
    told = []
    watch = FixedMarksWatch(SYSTEM_CLOCK, told.append)
    watch.judged(strip, judgement, Report(1, 1, strip.t, None, judgement.verdict))
    assert (judgement.verdict.status, told) == (CLEAR, [])


def test_a_strip_has_no_pictures():
    strip = Frame(1, 0.0, np.zeros((200_000, 1), np.uint8), None)
    with pytest.raises((ToktError, ValueError)):
        strip.pictures("left", DEFAULT_GRID).prepare((None,))
