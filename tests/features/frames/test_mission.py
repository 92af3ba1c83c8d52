import random
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import format_frames, open_mission, parse_frames

N_VIDEO = 14


def _write(path: Path, value: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((12, 16), value, np.uint8))


def test_stereo_folder(tmp_path):
    for number in (10, 2, 1):
        _write(tmp_path / "dive" / "Left" / f"tokt1_L_{number}.png", number)
        _write(tmp_path / "dive" / "RIGHT" / f"tokt1_R_{number}.png", number + 100)
    found = open_mission(tmp_path / "dive")
    assert found.name == "dive"
    assert found.cameras == ("left", "right")
    assert found.frames() == found.frames("right") == [1, 2, 10]
    assert (found.read(10) == 10).all() and (found.read(2, "right") == 102).all()
    data, suffix = found.encoded(2)
    assert suffix == ".png"
    assert data == (tmp_path / "dive" / "Left" / "tokt1_L_2.png").read_bytes()
    assert found.frames("rear") == []
    for frame, camera in ((3, "left"), (1, "rear")):
        with pytest.raises(FrameError, match=f"no {camera} frame {frame}"):
            found.read(frame, camera)


def test_flat_folder_and_what_is_passed_over(tmp_path):
    for number in (1, 2, 10):
        _write(tmp_path / f"f{number:03}.png", number)
    _write(tmp_path / "big.JPG.7.PNG", 7)
    for name in (".hidden_4.png", "labels.csv", "notes 5.txt", "no_suffix_6"):
        (tmp_path / name).write_bytes(b"nothing to look at")
    found = open_mission(str(tmp_path))
    assert found.cameras == ("left",)
    assert found.frames() == [1, 2, 7, 10]
    assert (found.read(7) == 7).all()


def test_stereo_wins_over_images_beside_it(tmp_path):
    _write(tmp_path / "left" / "a_5.png", 5)
    _write(tmp_path / "map_1.png", 1)
    assert open_mission(tmp_path).frames() == [5]


def test_a_name_of_its_own(video, tmp_path, monkeypatch):
    _write(tmp_path / "a=b" / "f_1.png", 1)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to("a=b")
    assert open_mission("link").name == open_mission("a=b").name == "a=b"
    named = open_mission("dive-7.1=a=b")
    assert (named.name, named.path) == ("dive-7.1", Path("a=b"))
    assert open_mission(Path(f"dive_7={tmp_path}/link")).name == "dive_7"
    assert open_mission(f"filmed={video}").name == "filmed"
    (tmp_path / "dive_7=link").symlink_to("a=b")  # as it is written, it is there
    assert open_mission("dive_7=link").name == "a=b"
    for text in ("dive 7=a=b", "../x=link", "=link", "x=", "x=y"):
        refuses("does not exist", open_mission, text)


def test_unreadable_frames_are_frame_errors(tmp_path):
    for number in (1, 2, 3):
        _write(tmp_path / f"{number}.png", number)
    whole = (tmp_path / "2.png").read_bytes()
    found = open_mission(tmp_path)
    (tmp_path / "1.png").unlink()
    (tmp_path / "2.png").write_bytes(whole[:-8])
    for number in (1, 2):
        with pytest.raises(FrameError):
            found.read(number)
    assert (found.read(3) == 3).all()


def test_refused_folders(tmp_path):
    refuses("does not exist", open_mission, tmp_path / "none")
    refuses("no frames", open_mission, tmp_path)
    _write(tmp_path / "only right" / "Right" / "r_1.png", 1)
    refuses("no frames", open_mission, tmp_path / "only right")
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "1.dng").write_bytes(b"II*")
    refuses(r"it has 1 picture of a kind .* \(.dng\)", open_mission, tmp_path / "raw")
    (tmp_path / "labels.csv").write_text("mission,frame\n")
    refuses("neither", open_mission, tmp_path / "labels.csv")


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "dive 3.avi"
    rng = np.random.default_rng(3)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    assert writer.isOpened()
    for number in range(1, N_VIDEO + 1):
        noise = rng.integers(0, 6, (48, 64, 3))
        writer.write((noise + 12 * number).astype(np.uint8))
    writer.release()
    return path


def test_video_frames_by_any_order(video):
    found = open_mission(video)
    assert found.name == "dive 3" and found.cameras == ("left",)
    assert found.frames() == list(range(1, N_VIDEO + 1))
    assert found.frames("right") == []
    in_order = {number: found.read(number) for number in found.frames()}
    for number, image in in_order.items():
        assert image.shape == (48, 64, 3) and image.dtype == np.uint8
        assert abs(float(image.mean()) - (12 * number + 2.5)) < 3
    order = [number for number in in_order for _ in range(3)]
    random.Random(5).shuffle(order)
    again = open_mission(video)
    assert all(np.array_equal(again.read(number), in_order[number]) for number in order)
    for number in (0, -1, N_VIDEO + 1):
        with pytest.raises(FrameError, match=f"no left frame {number}"):
            again.read(number)
    with pytest.raises(FrameError):
        again.read(1, "right")


@pytest.mark.parametrize("bits", [12, 16])
def test_a_video_of_16_bits_is_held_to_what_image_files_are(tmp_path, bits):
    path, depth = tmp_path / "deep.mkv", [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U]
    codec = cv2.VideoWriter.fourcc(*"FFV1")
    gray = [cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, 10.0, (64, 48), depth + gray)
    levels = np.linspace(0, 2**bits - 1, 64 * 48).reshape(48, 64).astype(np.uint16)
    for _ in range(3):
        writer.write(levels)
    writer.release()
    found = open_mission(path)
    if bits == 12:
        with pytest.raises(FrameError, match=r"deep\.mkv: frame 2: its 16-bit pixels leave the"):
            found.read(2)
    else:
        assert np.abs(found.read(2)[..., 0] - (levels >> 8).astype(int)).max() <= 1


def test_video_frames_as_files(video):
    found = open_mission(video)
    data, suffix = found.encoded(4)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR)
    assert suffix == ".png" and np.array_equal(decoded, found.read(4))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_truncated_video(video, tmp_path, share):
    """What is left keeps its numbers; what is gone is a FrameError, however often it is asked."""
    data = video.read_bytes()
    cut = tmp_path / "cut.avi"
    cut.write_bytes(data[: int(len(data) * share)])
    whole = open_mission(video)
    truth = {number: whole.read(number) for number in whole.frames()}
    try:
        found = open_mission(cut)
    except ToktError:
        return
    read: dict[int, bool] = {}
    order = [*found.frames(), *reversed(found.frames()), 2, 2, N_VIDEO, 1]
    for number in order:
        try:
            image = found.read(number)
        except FrameError:
            good = False
        else:
            good = True
            if number < max(1, int(N_VIDEO * share) - 1):
                assert np.array_equal(image, truth[number])
        assert read.setdefault(number, good) is good


@pytest.mark.parametrize("damage", [b"\x00", b"\xff\xd8"])
def test_a_damaged_frame_does_not_move_the_numbers(video, tmp_path, damage):
    data = bytearray(video.read_bytes())
    position = data.index(b"movi")
    for _ in range(6):
        position = data.index(b"00dc", position + 4)
    size = int.from_bytes(data[position + 4 : position + 8], "little")
    data[position + 8 : position + 8 + size] = (damage * size)[:size]
    broken = tmp_path / "broken.avi"
    broken.write_bytes(data)
    whole = open_mission(video)
    truth = {number: whole.read(number) for number in whole.frames()}
    unreadable = set()
    in_order, mixed = list(truth), [8, 6, 6, 7, 5, 6, 14, 7, 6, 8, 1]
    for order in (in_order, mixed, in_order[::-1]):
        found = open_mission(broken)
        for number in order:
            try:
                image = found.read(number)
            except FrameError:
                unreadable.add(number)
            else:
                assert number == 6 or np.array_equal(image, truth[number]), number
    assert all(number >= 6 for number in unreadable)


@pytest.mark.parametrize("content", [b"", b"RIFF", b"no video at all" * 100])
def test_not_a_video(tmp_path, content):
    path = tmp_path / "dive.mp4"
    path.write_bytes(content)
    refuses("not a video", open_mission, path)


@given(st.sets(st.integers(0, 400)).filter(bool))
def test_frame_lists_round_trip(frames):
    text = format_frames(frames)
    assert parse_frames(text) == sorted(frames)
    assert text == format_frames(parse_frames(text))


def test_frame_lists():
    assert parse_frames("132-134, 1-3,2, 9") == [1, 2, 3, 9, 132, 133, 134]
    assert format_frames([7, 3, 2, 1, 2]) == "1-3,7"
    assert format_frames([]) == ""


@pytest.mark.parametrize(
    "text", ["", "a", "1-", "-3", "3-1", "1,,2", "1;2", "1.5", "1-2-3", "9" * 5000, "0-99999999999"]
)
def test_refused_frame_lists(text):
    refuses(r"not a list of frames|too long", parse_frames, text)


@pytest.mark.mission
def test_real_mission(mission):
    found = open_mission(mission)
    assert found.name == "approach"
    assert found.frames("left") == found.frames("right") == list(range(1, 247))
    assert found.read(186).shape[:2] == (1024, 1360)
