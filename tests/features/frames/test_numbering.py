import json
import random
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.features.frames.mission import LEFT, RIGHT, open_mission
from tokt.features.frames.numbering import RECORD, natural_order

PICTURE = cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1].tobytes()


def put(folder, *names):
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(PICTURE)
    return folder


def names_of(mission, camera=LEFT):
    """File names by frame number, in the mission's order."""
    return {number: mission.file(number, camera).name for number in mission.frames(camera)}


def test_order_is_that_of_the_whole_name_and_numbers_stay(tmp_path):
    """A dive over midnight, times with fractions, nanoseconds."""
    dives = {
        "midnight": [
            "A-1_20190513_235950.png",
            "A-1_20190513_235955.png",
            "A-1_20190514_000005.png",
        ],
        "seconds": ["1461155400.923456.png", "1461155401.023456.png", "1461155401.123456.png"],
        "unequal": ["1461155400.25.png", "1461155400.5.png", "1461155401.0625.png"],
        "nanoseconds": ["1403636579763555584.png", "1403636579813555456.png"],
        "plain": ["dive_2.png", "dive_10.png", "dive_100.png"],
    }
    for name, files in dives.items():
        mission = open_mission(put(tmp_path / name, *random.Random(1).sample(files, len(files))))
        assert list(names_of(mission).values()) == files
        assert [mission.place(number) for number in mission.frames()] == [*range(len(files))]
        assert not (tmp_path / name / RECORD).exists()
    assert open_mission(tmp_path / "midnight").frames() == [235950, 235955, 5]
    assert open_mission(tmp_path / "nanoseconds").frames()[0] == 1403636579763555584


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=20, unique=True), st.integers(0, 9))
def test_names_that_end_in_different_numbers_are_in_their_order(numbers, width):
    names = [f"dive_1_{number:0{width}d}.png" for number in numbers]
    ordered = sorted(map(Path, names), key=natural_order)
    assert ordered == sorted(ordered, key=lambda path: int(path.stem.rpartition("_")[2]))


AMBIGUOUS = ["T1-01.png", "T1-02.png", "T2-01.png", "T2-02.png", "IMG_0007.png"]
AMBIGUOUS += ["IMG_0007 (1).png"]
AMBIGUOUS += [
    "T1-01.jpg",
    "left_1.png",
    "right_1.png",
    "GP_000123_rect_color.png",
    "20190513T101112.123Z.png",
]


@given(st.lists(st.sampled_from(AMBIGUOUS), min_size=2, unique=True), st.randoms())
def test_a_number_is_given_once_and_stays_whatever_is_added(tmp_path_factory, names, rng):
    """Files come one after the other, in any order; each keeps the number it was first given."""
    folder = tmp_path_factory.mktemp("growing") / "dive"
    given_numbers = {}
    for name in names:
        mission = open_mission(put(folder, name))
        now = {file: number for number, file in names_of(mission).items()}
        kept = (folder / RECORD).exists()
        for file, number in now.items():
            if kept and file in given_numbers:
                assert number == given_numbers[file]
        assert len(set(now.values())) == len(now) == len([*folder.glob("*.[jp][pn]g")])
        given_numbers = now if kept else {}
        if len(now) > 1 and rng.random() < 0.3:
            (folder / rng.choice(sorted(now))).unlink()
    places = [mission.place(number) for number in mission.frames()]
    assert places == [*range(len(places))]


def test_a_number_that_two_files_end_in_is_neither_s(tmp_path):
    """Labels with it may be of either: they find no frame, and land on no wrong one."""
    dive = put(tmp_path / "dive", "T1-01.png", "T1-02.png", "T1-05.png")
    assert names_of(open_mission(dive)) == {1: "T1-01.png", 2: "T1-02.png", 5: "T1-05.png"}
    put(dive, "T0-01.png", "T0-02.png")
    assert names_of(open_mission(dive)) == {
        6: "T0-01.png",
        7: "T0-02.png",
        8: "T1-01.png",
        9: "T1-02.png",
        5: "T1-05.png",
    }
    put(dive, "T0-03.png")  # in the middle of the folder
    assert names_of(open_mission(dive))[3] == "T0-03.png"
    assert list(names_of(open_mission(dive)))[:3] == [6, 7, 3]
    (dive / "T1-02.png").unlink()
    put(dive, "T3-01.png")
    assert names_of(open_mission(dive))[10] == "T3-01.png"  # not that of the file that is gone


def test_pairs_are_by_whole_name(tmp_path):
    left = ["1461155400.923.png", "1461155401.023.png", "1461155402.923.png"]
    right = ["1461155400.925.png", "1461155401.925.png", "1461155402.023.png"]
    put(tmp_path / "stamps" / "Left", *left)
    put(tmp_path / "stamps" / "Right", *right)
    stamps = open_mission(tmp_path / "stamps")
    assert not set(stamps.frames(LEFT)) & set(stamps.frames(RIGHT))
    for names in (
        ("tokt1_L_{}.png", "tokt1_R_{}.png"),
        ("cam0_{}.png", "cam1_{}.png"),
        ("{}.png", "{}.png"),
        ("T1-{}_left.png", "T1-{}_right.png"),
    ):
        folder = tmp_path / names[0].format("x")
        for side, name in zip(("Left", "Right"), names, strict=True):
            numbers = (n for n in range(1, 12) if (side, n) != ("Right", 5))
            put(folder / side, *(name.format(f"{n:02}") for n in numbers))
        mission = open_mission(folder)
        assert len(mission.frames(LEFT)) == 11 and len(mission.frames(RIGHT)) == 10
        assert set(mission.frames(RIGHT)) < set(mission.frames(LEFT)), names
    put(tmp_path / "single" / "Left", "dive_L_3.png")
    put(tmp_path / "single" / "Right", "dive_R_20.png")
    for side, letter in (("Left", "A"), ("Right", "B")):
        put(tmp_path / "odd" / side, *(f"cam{letter}_000{n}.png" for n in (1, 2)), "thumb.png")
        names = [f"c_1{n}{ord(letter) % 9}0_000{n}.png" for n in (1, 2, 3)]
        put(tmp_path / "counted" / side, *names)
    put(tmp_path / "growing" / "Left", "camA_0001.png", "camA_0002.png")
    put(tmp_path / "growing" / "Right", "camB_0001.png")
    for name, numbers in (("odd", {1, 2}), ("counted", {1, 2, 3}), ("growing", {1})):
        mission = open_mission(tmp_path / name)
        assert numbers <= set(mission.frames(LEFT)) & set(mission.frames(RIGHT)), name
    single = open_mission(tmp_path / "single")
    assert (single.frames(LEFT), single.frames(RIGHT)) == ([3], [20])
    over_midnight = tmp_path / "over_midnight"
    put(over_midnight / "Left", "L_20190513_235959.png", "L_20190514_000000.png")
    put(over_midnight / "Right", "R_20190514_000000.png")
    mission = open_mission(over_midnight)
    assert (mission.frames(LEFT), mission.frames(RIGHT)) == ([235959, 0], [0])


def test_yesterdays_record_is_read_and_others_are_refused(tmp_path):
    dive = put(tmp_path / "dive", "T1-01.png", "T2-01.png")
    record = dive / RECORD
    record.write_text('{"format": 1, "numbers": {"left": {"T2-01.png": 40, "gone.png": 41}}}')
    assert names_of(open_mission(dive)) == {42: "T1-01.png", 40: "T2-01.png"}
    assert json.loads(record.read_text())["numbers"]["left"]["gone.png"] == 41
    record.write_text('{"format": 2, "numbers": {}}')
    refuses("newer than this tokt reads", open_mission, dive)
    for text in ("", "{", "[]", '{"format": 1, "numbers": {"left": {"a": 1, "b": 1}}}'):
        record.write_text(text)
        refuses("record of frame numbers .* is damaged", open_mission, dive)


@pytest.mark.parametrize("ending", ["webp", "jp2", "jfif", "gif"])
def test_pictures_of_other_kinds_are_frames_too(tmp_path, ending):
    image = np.full((48, 64, 3), 90, np.uint8)
    kind = ".jpg" if ending == "jfif" else f".{ending}"
    (tmp_path / f"1.{ending}").write_bytes(cv2.imencode(kind, image)[1].tobytes())
    assert open_mission(tmp_path).read(1).shape == (48, 64, 3)


def test_a_converted_picture_keeps_its_number_and_the_record_can_be_read(tmp_path):
    for side in ("Left", "Right"):
        put(tmp_path / side, "T1-01.png", "T2-01.png")
    before = {camera: names_of(open_mission(tmp_path), camera) for camera in (LEFT, RIGHT)}
    (tmp_path / "Right" / "T1-01.png").rename(tmp_path / "Right" / "T1-01.bmp")
    for _ in range(2):
        after = names_of(open_mission(tmp_path), RIGHT)
        assert {n: Path(name).stem for n, name in after.items()} == {
            n: Path(name).stem for n, name in before[RIGHT].items()
        }
        assert names_of(open_mission(tmp_path)) == before[LEFT]


@pytest.mark.skipif(sys.platform != "linux", reason="names of any bytes")
def test_names_that_are_not_utf_8_can_be_opened(tmp_path):
    for letter in (b"a", b"b"):
        Path(
            str(tmp_path), (b"d_\xfc_" + letter + b".png").decode("utf-8", "surrogateescape")
        ).write_bytes(PICTURE)
    mission = open_mission(tmp_path)
    assert len(mission.frames()) == 2 and mission.file_name(mission.frames()[0]) is None
