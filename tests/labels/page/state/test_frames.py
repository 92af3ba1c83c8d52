"""Frames of a video for several readers at once: the right ones, without reading it all again."""

import gc
import random
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from tests.fixtures import write_video
from tests.waiting import MAX_S
from tokt.features.common.errors import FrameError
from tokt.features.frames.mission import VideoMission, open_mission
from tokt.labels.page import frames
from tokt.labels.page.frames import encoded_frame, for_background, read_frame

N = 80
FRAME_BYTES = 48 * 64 * 3


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    rng = np.random.default_rng(3)
    images = ((rng.integers(0, 9, (48, 64, 3)) + 3 * n).astype(np.uint8) for n in range(1, N + 1))
    return write_video(tmp_path_factory.mktemp("video") / "dive.avi", images)


@pytest.fixture(scope="module")
def truth(video):
    mission = open_mission(video)
    return {number: mission.read(number) for number in mission.frames()}


@pytest.fixture
def opened(monkeypatch):
    """Grows whenever a video file is opened."""
    real, found = cv2.VideoCapture, list[str]()

    def capture(path):
        found.append(path)
        return real(path)

    monkeypatch.setattr(cv2, "VideoCapture", capture)
    return found


def test_stepping_back_opens_the_file_only_for_what_lies_near_its_start(video, truth, opened):
    mission = open_mission(video)
    for number in range(N, 0, -1):
        assert np.array_equal(read_frame(mission, "left", number), truth[number])
    assert len(opened) == 1 + 2


def test_going_to_and_fro_reads_nothing_again(video, truth, opened):
    mission = open_mission(video)
    for number in (70, 71, 70, 71, 70, 68, 72, 71, 70):
        assert np.array_equal(read_frame(mission, "left", number), truth[number])
    assert len(opened) == 1


class Inexact:
    """A video file in which seeking comes out `off` frames away, as in some files it does."""

    def __init__(self, real, off):
        self._real, self._off = real, off

    def __getattr__(self, name):
        return getattr(self._real, name)

    def set(self, name, value):
        return self._real.set(name, value + self._off)


@pytest.mark.parametrize("off", [0, 1, -3, 5000])
def test_a_seek_that_is_not_exact_is_noticed_and_not_tried_again(video, truth, monkeypatch, off):
    real, opened = cv2.VideoCapture, []
    monkeypatch.setattr(
        cv2, "VideoCapture", lambda path: opened.append(path) or Inexact(real(path), off)
    )
    mission = open_mission(video)
    for number in (N, 50, 49, 20, 66, 33, N):
        assert np.array_equal(mission.read(number), truth[number]), number
    assert len(opened) == (1 if off == 0 else 5)


@pytest.mark.parametrize(("suffix", "codec"), [(".mp4", "mp4v"), (".avi", "XVID")])
def test_a_file_with_key_frames_far_apart_is_stepped_back_in(tmp_path, opened, codec, suffix):
    path = tmp_path / f"dive{suffix}"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10.0, (64, 48))
    noise = np.random.default_rng(3).integers(0, 255, (48, 464, 3)).astype(np.uint8)
    for n in range(400):
        writer.write(noise[:, n : n + 64] if not 200 < n < 250 else noise[:, 200:264])
    writer.release()
    forward = open_mission(path)
    truth = {number: forward.read(number) for number in forward.frames()}
    mission = open_mission(path)
    for number in (400, *range(399, 170, -1), 390, 60):
        assert np.array_equal(read_frame(mission, "left", number), truth[number]), number
    assert len(opened) == 2


@pytest.mark.parametrize("kept", [0, 3, 1000])
def test_any_order_gives_the_right_frames(video, truth, monkeypatch, kept):
    monkeypatch.setattr(frames, "KEPT_BYTES", kept * FRAME_BYTES)
    mission = open_mission(video)
    near = random.Random(kept)
    at = N // 2
    for _ in range(60):
        at = min(N, max(1, at + near.choice((-30, -3, -1, -1, 1, 1, 3, 30))))
        image = read_frame(mission, "left", at)
        assert np.array_equal(image, truth[at])
        image[:] = 0  # it is the caller's own


def test_many_threads(video, truth, monkeypatch):
    monkeypatch.setattr(frames, "KEPT_BYTES", 30 * FRAME_BYTES)
    mission = open_mission(video)
    order = random.Random(1).choices(range(1, N + 1), k=200)
    with ThreadPoolExecutor(6) as pool:
        found = pool.map(lambda number: read_frame(mission, "left", number), order)
        assert all(np.array_equal(f, truth[n]) for f, n in zip(found, order, strict=True))


def test_kept_frames_do_not_wait_for_the_file(video, truth, monkeypatch):
    mission = open_mission(video)
    read_frame(mission, "left", 5)
    reading, go_on = threading.Event(), threading.Event()
    real = VideoMission.read

    def slow(self, frame, camera="left"):
        reading.set()
        assert go_on.wait(MAX_S)
        return real(self, frame, camera)

    monkeypatch.setattr(VideoMission, "read", slow)
    with ThreadPoolExecutor(2) as pool:
        far = pool.submit(read_frame, mission, "left", 60)
        assert reading.wait(MAX_S)
        near = pool.submit(read_frame, mission, "left", 5)
        assert np.array_equal(near.result(MAX_S), truth[5])
        assert not far.done()
        go_on.set()
        assert np.array_equal(far.result(MAX_S), truth[60])


def test_files_of_frames(video, truth, opened):
    mission = open_mission(video)
    for number in (9, 8, 7):
        found, direct = encoded_frame(mission, "left", number), cv2.imencode(".png", truth[number])
        assert found == (direct[1].tobytes(), ".png")
    assert len(opened) == 2


def test_frames_that_cannot_be_read(video, tmp_path):
    for camera, number in (("left", 0), ("left", N + 1), ("right", 1)):
        for read in (read_frame, encoded_frame):
            with pytest.raises(FrameError, match=f"no {camera} frame {number}"):
                read(open_mission(video), camera, number)
    damaged = tmp_path / "dive.avi"
    data = bytearray(video.read_bytes())
    data[len(data) // 2 : -4000] = bytes(len(data) - len(data) // 2 - 4000)
    damaged.write_bytes(data)
    direct, mission = open_mission(damaged), open_mission(damaged)
    wrong = 0
    for number in (*range(N, 0, -1), N, 1):
        try:
            expected = direct.read(number)
        except FrameError as error:
            wrong += 1
            with pytest.raises(FrameError) as raised:
                read_frame(mission, "left", number)
            assert str(raised.value) == str(error)
        else:
            assert np.array_equal(read_frame(mission, "left", number), expected)
    assert 0 < wrong < N


@pytest.mark.parametrize(("room", "own", "reopens"), [(99, False, 0), (3, False, 1), (99, True, 1)])
def test_frames_are_kept_as_far_as_there_is_room_and_none_of_the_background(
    video, truth, opened, monkeypatch, room, own, reopens
):
    monkeypatch.setattr(frames, "KEPT_BYTES", room * FRAME_BYTES)
    mission = open_mission(video)
    mission = for_background(mission) if own else mission
    for number in (10, 20, 30, 40):
        assert np.array_equal(read_frame(mission, "left", number), truth[number])
    opened.clear()
    assert np.array_equal(read_frame(mission, "left", 10), truth[10])
    assert len(opened) == reopens


@pytest.mark.parametrize("own", [for_background, lambda mission: mission])
def test_a_video_that_is_done_with_takes_no_memory(video, truth, own):
    mission = open_mission(video)
    reader = own(mission)
    assert np.array_equal(read_frame(reader, "left", 2), truth[2])
    kept = weakref.ref(reader)
    del mission, reader
    gc.collect()
    assert kept() is None


def test_folders_are_read_as_they_are(tiny):
    mission = open_mission(tiny.path)
    assert for_background(mission) is mission
    assert encoded_frame(mission, "left", 3) == mission.encoded(3)
    assert np.array_equal(read_frame(mission, "left", 3), mission.read(3))
