import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tokt.inference.sources.files import open_source


def test_a_stereo_folder_gives_pairs_in_numeric_order(make_mission, hand_clock):
    source = open_source(str(make_mission([[]] * 12)), hand_clock)
    frames = list(source)
    assert [frame.number for frame in frames] == list(range(1, 13))
    assert all(frame.left is not None and frame.right is not None for frame in frames)
    assert frames[0].t == 1_000_100.0


def test_a_truncated_jpeg_is_a_frame_with_a_reason(make_mission, hand_clock):
    folder = make_mission([[(1, 1)]] * 3)
    file = folder / "Left" / "t_L_2.jpg"
    file.write_bytes(file.read_bytes()[:-500])
    (folder / "Right" / "t_R_3.jpg").unlink()
    frames = list(open_source(str(folder), hand_clock))
    assert [frame.left is None for frame in frames] == [False, True, False]
    assert "truncated" in frames[1].left_fault
    assert frames[2].right is None and "no right frame 3" in frames[2].right_fault


def test_a_rate_paces_by_deadlines(make_mission, hand_clock):
    times = []
    for frame in open_source(str(make_mission([[]] * 5)), hand_clock, rate=4.0):
        times.append(frame.t - 1_000_100.0)
        if frame.number == 2:
            hand_clock.now += 0.6  # a slow round: frame 3 is late, frame 4 is not
        else:
            hand_clock.now += 0.1
    assert times == pytest.approx([0, 0.25, 0.85, 0.95, 1.05])


def test_a_rate_does_not_drift(make_mission, hand_clock):
    times = []
    for frame in open_source(str(make_mission([[]] * 30)), hand_clock, rate=10.0):
        times.append(frame.t - 1_000_100.0)
        hand_clock.now += 0.0371
    assert times == pytest.approx([index / 10 for index in range(30)])


def test_stop_ends_even_a_long_wait(make_mission, hand_clock):
    source = open_source(str(make_mission([[]] * 3)), hand_clock, rate=0.001)
    sleep = hand_clock.sleep

    def sleep_then_stop(seconds: float, /) -> None:
        sleep(seconds)
        source.stop()

    hand_clock.sleep = sleep_then_stop
    assert [frame.number for frame in source] == [1]
    assert sum(hand_clock.slept) < 0.1


def test_frames_are_chosen_and_named_when_absent(make_mission, hand_clock):
    folder = str(make_mission([[]] * 4))
    assert [frame.number for frame in open_source(folder, hand_clock, [4, 2])] == [2, 4]
    refuses("has frames 1-4, not 7-8", open_source, folder, hand_clock, [2, 7, 8])


@pytest.mark.parametrize("stereo", [True, False])
def test_a_frame_that_only_the_right_camera_has_is_one_without_a_picture(
    make_mission, hand_clock, stereo
):
    folder = make_mission([[]] * 4)
    (folder / "Left" / "t_L_2.jpg").unlink()
    frames = list(open_source(str(folder), hand_clock, stereo=stereo))
    assert [frame.number for frame in frames] == [1, 2, 3, 4]
    assert frames[1].left is None and "no left frame 2" in frames[1].left_fault
    assert [f.number for f in open_source(str(folder), hand_clock, [2], stereo=stereo)] == [2]


def test_sources_rates_and_formats_that_cannot_be_are_refused(make_mission, hand_clock):
    for text in ("pymba:0", "no/such/place"):
        refuses("unknown source", open_source, text, hand_clock)
    folder = str(make_mission([[]]))
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        refuses("rate", open_source, folder, hand_clock, rate=rate)
    for name in ("", "BGR8", "BayerXX8"):
        words = "choose from Mono8, BayerRG8"
        refuses(words, open_source, folder, hand_clock, pixel_format=name)


def test_a_video_gives_its_frames(tmp_path, draw_frame, hand_clock):
    path = tmp_path / "dive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (360, 270))
    for number in range(4):
        picture = draw_frame([(number, number)])[:270]
        writer.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    writer.release()
    frames = list(open_source(str(path), hand_clock))
    assert [frame.number for frame in frames] == [1, 2, 3, 4]
    assert all(frame.left is not None and frame.left.shape == (270, 360, 3) for frame in frames)
    assert all(frame.right is None for frame in frames)


def test_a_raw_frame_is_made_a_colour_picture(tmp_path, hand_clock):
    raw = np.full((12, 16), 40, np.uint8)
    raw[::2, ::2] = 200  # red, in a pattern that begins with it
    for name, image in (("1", raw), ("2", raw[:2]), ("3", cv2.merge([raw] * 3))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    frames = list(open_source(str(tmp_path), hand_clock, pixel_format="BayerRG8"))
    np.testing.assert_array_equal(frames[0].left, np.full((12, 16, 3), (40, 40, 200)))
    assert frames[1].left is None and "too small" in frames[1].left_fault
    assert frames[2].left is None and "in colour" in frames[2].left_fault
    assert "not read" not in frames[0].left_fault and frames[0].right is None
    gray = next(iter(open_source(str(tmp_path), hand_clock, pixel_format="Mono8")))
    np.testing.assert_array_equal(gray.left, raw)
