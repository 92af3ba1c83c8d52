"""Blocks go by time where it is known, and else by the order of the frames; never by numbers."""

from itertools import pairwise

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tests.calls import refuses
from tests.fixtures import write_video
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets.dive_positions import TIMES_FILE, dive_positions, scene_length
from tokt.training.datasets.folds import blocked_folds
from tokt.training.datasets.mission_source import (
    LabelledMission,
    labels_of_mission,
    plan_from_missions,
)

GRID = Grid(2, 2, None)
TIME = "2016-04-20T10:00:00Z"


def dive(folder, numbers, hold=1, n=60):
    """A mission of frames whose scene goes over into another one within some `hold` frames."""
    folder.mkdir()
    rng = np.random.default_rng(5)
    steps = rng.normal(0, 1, (n // hold + 2, 6, 8))
    for index, number in enumerate(numbers):
        before, part = divmod(index / hold, 1)
        scene = (1 - part) * steps[int(before)] + part * steps[int(before) + 1]
        picture = cv2.resize(scene, (64, 48), interpolation=cv2.INTER_CUBIC) * 40 + 120
        cv2.imwrite(str(folder / f"f_{number:06d}.png"), picture.clip(0, 255).astype(np.uint8))
    return open_mission(folder)


def plan(mission, frames=None):
    records = [
        LabelRecord(
            *(mission.name, "left", number, GRID, row, col),
            "ocean" if (mission.place(number) // 7 + row) % 2 else "other",
            *("eva", TIME),
        )
        for number in mission.frames()
        for row in range(2)
        for col in range(2)
    ]
    of = [LabelledMission(mission, records)]
    return plan_from_missions("d", "binary", of, Taxonomy.load(), GRID, frames)


def folds_of(planned):
    """The places in the dive that each fold learns from and is tested on."""
    places = {source.position: n for n, source in enumerate(planned.frames)}
    groups = {source.position: source.group.partition("#")[2] for source in planned.frames}
    table = planned.patches.assign(group=planned.patches.position.map(groups), mission="m")
    targets = table.label.eq("other").to_numpy().astype(np.int64)
    return [
        tuple({places[p] for p in table.position.iloc[rows]} for rows in (fold.train, fold.test))
        for fold in blocked_folds(table, targets, 3, planned.block_frames // 4)
    ]


@pytest.mark.parametrize("step", [10, 15, 1000])
def test_numbers_in_steps_change_no_split(tmp_path, step):
    """As tools number every tenth frame of a video: the same pictures, the same folds."""
    one, _ = plan(dive(tmp_path / "one", range(1, 61)))
    other, _ = plan(dive(tmp_path / "other", range(step, 60 * step + 1, step)))
    assert one.block_frames == other.block_frames == 20
    assert folds_of(one) == folds_of(other)
    for train, test in folds_of(other):
        assert min(abs(a - b) for a in train for b in test) > 5


@given(st.lists(st.integers(1, 10**6), min_size=45, max_size=60, unique=True), st.integers(0, 9))
def test_no_test_frame_is_near_a_training_frame_whatever_the_numbers(numbers, seed):
    order = np.random.default_rng(seed).permutation(len(numbers))
    table = pd.DataFrame({"mission": "m", "frame": numbers, "position": order})
    table["group"] = [f"m#{place // 10:05d}" for place in order]
    for fold in blocked_folds(table, np.arange(len(numbers)) % 2, 3, 4):
        gaps = np.abs(order[fold.train][:, None] - order[fold.test])
        assert gaps.min() > 4


@pytest.mark.parametrize("hold", [1, 8, 16])
def test_a_block_is_as_long_as_the_scene_stays_the_same(tmp_path, hold):
    """Filmed twice, four times as fast, a scene stays for twice, four times as many frames."""
    lengths = {}
    for times in (1, 2, 4):
        mission = dive(tmp_path / f"x{times}", range(1, 200 * times + 1), hold * times, 200 * times)
        lengths[times] = scene_length(mission, dive_positions(mission).of_frame)
    assert lengths[1] <= 3 * hold
    for times in (2, 4):
        assert lengths[times] == pytest.approx(times * lengths[1], rel=0.4, abs=3)


def test_blocks_are_as_long_as_the_scene_where_labels_bear_it_and_else_it_is_said(tmp_path):
    slow = dive(tmp_path / "slow", range(1, 241), hold=40, n=240)
    whole, remarks = plan(slow)
    assert 20 < whole.scene_frames["slow"] == whole.block_frames and not remarks
    few, (remark,) = plan(slow, frames=range(100, 160))
    assert few.block_frames < few.scene_frames["slow"]
    assert "longer than a block" in remark and "figures flatter" in remark


def test_time_decides_where_it_is_known(tmp_path):
    mission = dive(tmp_path / "d", range(1, 7))
    names = [mission.file(number).name for number in mission.frames()]
    assert [*dive_positions(mission).of_frame.values()] == [1, 2, 3, 4, 5, 6]
    times = tmp_path / "d" / TIMES_FILE
    rows = zip(names, ["0", "0.5", "1.0", "1.5", "31.5", "32.0"], strict=True)
    times.write_text("file,time\n" + "".join(f"{name},{at}\n" for name, at in rows))
    assert [*dive_positions(mission).of_frame.values()] == [1, 2, 3, 4, 64, 65]
    stamps = [f"2016-04-20T10:00:{second:02}Z" for second in (0, 1, 2, 3, 4, 14)]
    rows = zip(names, stamps, strict=True)
    times.write_text("file,time\n" + "".join(f"{name},{at}\n" for name, at in rows))
    assert [*dive_positions(mission).of_frame.values()] == [1, 2, 3, 4, 5, 15]
    times.write_text("file,time\n" + "".join(f"{name},{-n}\n" for n, name in enumerate(names)))
    found = dive_positions(mission)
    assert "earlier than the one before it" in found.remark
    assert [*found.of_frame.values()] == [1, 2, 3, 4, 5, 6]
    for odd in ("nan", "1e999", "soon", ""):
        times.write_text("file,time\n" + "".join(f"{name},{odd}\n" for name in names))
        assert "not a table of columns file and time" in dive_positions(mission).remark
    times.write_text("a,b\n1,2\n")
    assert "not a table of columns file and time" in dive_positions(mission).remark


def test_times_of_cameras_and_of_videos(tmp_path):
    folder = tmp_path / "photos"
    folder.mkdir()
    for number, second in enumerate((0, 2, 4, 6, 46), 1):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x9003] = f"2016:04:20 10:00:{second:02}"
        Image.new("L", (32, 24)).save(folder / f"p_{number}.jpg", exif=exif)
    assert [*dive_positions(open_mission(folder)).of_frame.values()] == [1, 2, 3, 4, 24]
    frames = (np.full((48, 64, 3), 10 * level, np.uint8) for level in range(5))
    video = open_mission(write_video(tmp_path / "v.avi", frames))
    assert [b - a for a, b in pairwise(dive_positions(video).of_frame.values())] == [1] * 4


def test_labels_go_to_the_file_that_they_were_given_on(tmp_path):
    """Its number in another folder is another one: the whole name is what the frame is."""
    mission = dive(tmp_path / "d", range(1, 4))
    said = ("d", "left", 3, GRID, 0, 0, "ocean", "eva", TIME)
    records = [LabelRecord(*said, file="f_000002.png"), LabelRecord(*said[:4], 0, 1, *said[6:])]
    found, _ = labels_of_mission(mission, records, GRID, only=True)
    assert [record.frame for record in found] == [2, 3]
    renamed = [LabelRecord(*said, file="f_000002.jpg")]  # a picture that was converted
    assert labels_of_mission(mission, renamed, GRID, only=True)[0][0].frame == 2
    gone = [LabelRecord(*said, file="g_000002.png")]
    refuses("no left picture 'g_000002.png'", labels_of_mission, mission, gone, GRID, only=True)
