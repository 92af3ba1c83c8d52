"""What a model suggests for the frames of a mission."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tests.fixtures import write_video
from tests.waiting import until
from tokt.features.common.errors import FrameError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.page.suggestions.suggester import Suggester, suggestions
from tokt.models.bundle.bundle import read_bundle
from tokt.models.linear import LinearModel


@pytest.fixture(scope="module")
def bundle(tiny_bundle):
    return read_bundle(tiny_bundle)


def ready(suggester):
    done, total = suggester.progress
    return done == total


def finished(suggester):
    suggester.background.start()
    until(lambda: ready(suggester))
    suggester.close()
    return suggester


def test_suggestions_are_what_the_bundle_computes(tiny, bundle, tmp_path):
    mission = open_mission(tiny.path)
    suggester = finished(Suggester(bundle, mission, Grid(), tmp_path))
    assert suggester.progress == (40, 40)
    for frame in mission.frames():
        values = bundle.decision_values(mission.read(frame))
        found = suggester.of("left", frame)
        assert found is not None and found.fault == ""
        assert np.array_equal(found.classes, bundle.model.predicted(values))
        assert np.array_equal(found.values, np.abs(values[:, 0] - bundle.model.thresholds[0]))
    assert {int(c) for c in found.classes} <= {0, 1} and (found.values >= 0).all()


def test_a_frame_that_is_not_known_yet_is_computed_at_once(tiny, bundle, tmp_path):
    suggester = Suggester(bundle, open_mission(tiny.path), Grid(), tmp_path)
    found = suggester.of("left", 33)
    assert found is not None and len(found.classes) == 100 and suggester.progress == (1, 40)
    assert suggester.of("left", 99) is None and suggester.of("right", 1) is None
    suggester.close()


def test_with_several_classes_the_margin_is_the_lead_over_the_second():
    thresholds, obstacles = np.array([0.0, 0.0, 1.0]), (False, True, True)
    model = LinearModel(np.eye(3), np.zeros(3), thresholds, ("a", "b", "c"), obstacles)
    found = suggestions(model, np.array([[2.0, 1.5, 0.0], [-3.0, -2.0, 1.5], [0.0, 0.0, 0.0]]))
    assert found.classes.tolist() == [0, 2, 0]
    assert found.values.tolist() == [0.5, 2.5, 0.0]


def test_another_grid_is_refused(tiny, bundle, tmp_path):
    refuses(r"10x10@360.*5x5@360", Suggester, bundle, open_mission(tiny.path), Grid(5, 5), tmp_path)


def test_faulty_frames_have_a_fault_and_no_suggestions(own_tiny, bundle, tmp_path):
    left = own_tiny.path / "Left"
    whole = (left / "tiny_L_7.png").read_bytes()
    (left / "tiny_L_7.png").write_bytes(whole[: len(whole) // 2])
    cv2.imwrite(str(left / "tiny_L_8.png"), np.full((100, 360), 20, np.uint8))
    cv2.imwrite(str(left / "tiny_L_9.png"), np.full((544, 720), 20, np.uint8))
    for _ in range(2):  # computed, then read from the file
        suggester = finished(Suggester(bundle, open_mission(own_tiny.path), Grid(), tmp_path))
        seven, eight, nine = (suggester.of("left", frame) for frame in (7, 8, 9))
        assert seven and eight and nine
        assert "truncated" in seven.fault and seven.classes.size == seven.values.size == 0
        assert eight.fault.startswith("frames are 360x100, which the model did not learn")
        assert nine.fault == "" and nine.classes.size == 100
        assert ready(suggester) and len(suggester.known().frames) == 38
        assert not {7, 8} & set(suggester.known().frames.tolist())


def test_a_restart_computes_nothing_again(tiny, bundle, tmp_path, monkeypatch):
    first = finished(Suggester(bundle, open_mission(tiny.path), Grid(), tmp_path))
    mission = open_mission(tiny.path)
    monkeypatch.setattr(mission, "read", lambda *frame: pytest.fail("computed again"))
    second = finished(Suggester(bundle, mission, Grid(), tmp_path))
    for frame in mission.frames():
        one, two = first.of("left", frame), second.of("left", frame)
        assert one and two and np.array_equal(one.classes, two.classes)
        assert np.array_equal(one.values, two.values)
    assert np.array_equal(first.known().features, second.known().features)


def counted(mission, monkeypatch):
    reads, read = [], mission.read
    monkeypatch.setattr(mission, "read", lambda n, camera: reads.append(n) or read(n, camera))
    return reads


@pytest.mark.parametrize("change", ["frame", "bundle", "damage", "garbage"])
def test_what_is_kept_of_other_files_or_models_is_not_used(
    change, own_tiny, bundle, tmp_path, monkeypatch
):
    cache = tmp_path / "cache"
    before = finished(Suggester(bundle, open_mission(own_tiny.path), Grid(), cache)).of("left", 1)
    (file,) = cache.iterdir()
    frame = own_tiny.path / "Left" / "tiny_L_1.png"
    if change == "frame":
        shutil.copy(own_tiny.path / "Left" / "tiny_L_5.png", frame)
    elif change == "bundle":
        bundle = replace(bundle, sha256="0" * 64)
    elif change == "damage":
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.write_bytes(data)
    else:
        file.write_bytes(b"PK no zip")
    mission = open_mission(own_tiny.path)
    reads = counted(mission, monkeypatch)
    after = finished(Suggester(bundle, mission, Grid(), cache)).of("left", 1)
    assert sorted(reads) == list(range(1, 41)) and before and after
    assert np.array_equal(before.values, after.values) == (change != "frame")


def test_a_frame_that_could_not_be_read_is_read_again_the_next_time(
    own_tiny, bundle, tmp_path, monkeypatch
):
    def no_read(frame, camera):
        if frame == 3:
            raise FrameError("the disk was not there for a moment")
        return read(frame, camera)

    mission = open_mission(own_tiny.path)
    read = mission.read
    monkeypatch.setattr(mission, "read", no_read)
    first = finished(Suggester(bundle, mission, Grid(), tmp_path)).of("left", 3)
    assert first and "the disk" in first.fault
    mission = open_mission(own_tiny.path)
    reads = counted(mission, monkeypatch)
    then = finished(Suggester(bundle, mission, Grid(), tmp_path)).of("left", 3)
    assert then and not then.fault and reads == [3]


def test_a_stop_in_the_middle_keeps_what_was_computed(tiny, bundle, tmp_path, monkeypatch):
    first = Suggester(bundle, open_mission(tiny.path), Grid(), tmp_path)
    first.background.start()
    until(lambda: first.progress[0] >= 3)
    first.close()
    done = first.progress[0]
    mission = open_mission(tiny.path)
    reads = counted(mission, monkeypatch)
    finished(Suggester(bundle, mission, Grid(), tmp_path))
    assert len(reads) == 40 - done


@pytest.mark.skipif(os.name == "nt", reason="folder permissions work otherwise on Windows")
def test_a_cache_that_cannot_be_written_costs_only_time(tiny, bundle, tmp_path):
    (tmp_path / "cache").write_text("a file where the folder should be")
    suggester = finished(Suggester(bundle, open_mission(tiny.path), Grid(), tmp_path / "cache"))
    assert ready(suggester)


def test_frames_near_the_one_shown_come_first(tiny, bundle, tmp_path, monkeypatch):
    mission = open_mission(tiny.path)
    reads = counted(mission, monkeypatch)
    suggester = Suggester(bundle, mission, Grid(), tmp_path)
    suggester.prefer("left", 30)
    finished(suggester)
    assert reads[0] == 30 and set(reads[:7]) == set(range(27, 34))


def test_many_threads_ask_while_all_is_computed(tiny, bundle, tmp_path):
    mission = open_mission(tiny.path)
    suggester = Suggester(bundle, mission, Grid(), tmp_path)
    suggester.background.start()

    def ask(frame):
        suggester.background.give_way()
        suggester.prefer("left", frame)
        found = suggester.of("left", frame)
        expected = bundle.model.predicted(bundle.decision_values(mission.read(frame)))
        return found is not None and np.array_equal(found.classes, expected)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(ask, [*range(40, 0, -1)] * 3))
    until(lambda: ready(suggester))
    suggester.close()


def test_a_video_is_read_forwards(bundle, tiny_truth, tmp_path):
    drawn = (cv2.cvtColor(tiny_truth.draw(n), cv2.COLOR_GRAY2BGR) for n in range(1, 13))
    path = write_video(tmp_path / "dive.avi", drawn)
    mission = open_mission(path)
    suggester = Suggester(bundle, mission, Grid(), tmp_path)
    suggester.prefer("left", 9)
    finished(suggester)
    for frame in (3, 9):
        found = suggester.of("left", frame)
        expected = bundle.model.predicted(bundle.decision_values(open_mission(path).read(frame)))
        assert found is not None and np.array_equal(found.classes, expected)
