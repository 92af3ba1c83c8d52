"""A video on a real server: stepped back in, and passed over by a pointer."""

import cv2
import numpy as np
import pytest

from tests.fixtures import write_video
from tokt.features.frames.mission import open_mission

N = 400


@pytest.fixture(scope="module")
def server(page_server, tmp_path_factory):
    noise = np.random.default_rng(3).integers(0, 255, (270, 360 + N, 3)).astype(np.uint8)
    images = (noise[:, n : n + 360] for n in range(N))
    video = write_video(tmp_path_factory.mktemp("video") / "dive.avi", images)
    return page_server("--annotator", "anna", mission=video)


def near(server, frame):
    return server.request("GET", f"/api/thumb/left/{frame}?width=176&near=1").status


def test_a_pointer_that_passes_does_not_have_a_long_video_read(server):
    assert (near(server, 50), near(server, 390)) == (200, 204)
    assert server.request("GET", "/api/thumb/left/380?width=176").status == 200
    assert (near(server, 390), near(server, 200)) == (200, 200)


def test_frames_are_the_same_forwards_and_backwards(server):
    forwards = open_mission(server.mission)
    truth = [forwards.read(number) for number in forwards.frames()]
    for frame in (N, *range(N - 1, N - 60, -1), 20, 333):
        data = server.request("GET", f"/api/picture/left/{frame}").body
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(picture, truth[frame - 1]), frame
