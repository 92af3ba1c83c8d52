"""Approaches in the labels, what is left at the first status, and false statuses an hour."""

import json
import shutil

import numpy as np
import pytest

from tests.calls import refuses
from tests.inference.stereo.plain_rig import PLAIN
from tokt.features.frames.mission import open_mission
from tokt.inference.frame import pixel_mark
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt.training.evaluation.approaches import (
    AtSea,
    KnownDistances,
    LoggedDistance,
    approach_figures,
    approaches,
    false_status_per_hour,
    known_distances,
)


def spans(kinds):
    """Approaches of frames from 10 on: o ocean, X obstacle, - neither."""
    kind = {10 + at: one for at, one in enumerate(kinds)}
    ocean, obstacle = ({n for n, one in kind.items() if one == sign} for sign in "oX")
    return approaches(sorted(kind), ocean, obstacle)


def test_an_approach_begins_after_ocean_and_ends_when_the_obstacle_is_gone():
    assert spans("oo--X-XX--") == [(14, 17)]
    assert spans("ooX" + 19 * "o" + "X") == [(12, 32)]
    assert spans("oX" + 19 * "o" + "-" + "oXX") == [(11, 11), (33, 34)]
    assert spans("--XX") == spans("oooo") == []
    assert spans("XX" + 19 * "o" + "X") == []
    assert spans("XX" + 20 * "o" + "X") == [(32, 32)]


def figures(status, ranges, stopping_m=None, missed=None):
    frames = list(range(10, 10 + len(status)))
    span = [(12, frames[-1])]
    (found,) = approach_figures(
        frames, missed or [0] * len(frames), status, span, ranges, stopping_m
    )
    return found


def coming(metres_a_frame, wrong=()):
    """Distances of frames 12 to 40 at 10 frames a second, 8 m in frame 20."""
    distance = {n: 8 - metres_a_frame * (n - 20) for n in range(12, 41)}
    return KnownDistances(
        {**distance, **dict.fromkeys(wrong, 30.0)}, {n: n / 10 for n in range(10, 60)}
    )


def test_what_is_left_at_the_first_status():
    """A status before the first obstacle frame is none of this approach's."""
    status = [1, 1, *8 * [0], *30 * [1]]
    found = figures(status, coming(0.1, wrong=(18, 25, 26)), 8.0)
    assert (found["first_status"], found["frames_late"]) == (20, 8)
    assert (found["distance_m"], found["distance_frame"], found["enough"]) == (8.0, 20, True)
    assert np.isclose(found["closing_m_s"], 1.0) and np.isclose(found["contact_s"], 8.0)
    assert figures(status, coming(0.1), 8.01)["enough"] is False
    assert figures(status, coming(0.1))["enough"] is None
    missed = [0, 0, 0, 5, *36 * [0]]
    assert figures(status, coming(0.1), missed=missed)["frames_late"] == 13
    # What does not come closer is no contact, and without times nothing is said of one.
    for still in (coming(0.004), coming(-0.1), KnownDistances(coming(0.1).distance_m)):
        assert figures(status, still)["contact_s"] is None
    few = KnownDistances({20: 8.0, 21: 7.9, 22: 7.8}, coming(0.1).seconds)
    assert figures(status, few)["closing_m_s"] is None


def test_no_status_is_too_late_and_no_distance_is_not_judged():
    silent = figures(31 * [0], coming(0.1), 5.0)
    assert (silent["first_status"], silent["distance_m"], silent["enough"]) == (None, None, False)
    status = [0, 0, *38 * [1]]
    for first, metres, enough in ((22, 7.8, True), (23, None, None)):
        seen = KnownDistances({n: m for n, m in coming(0.1).distance_m.items() if n >= first})
        found = figures(status, seen, 5.0)
        assert (found["first_status"], found["enough"]) == (12, enough)
        assert found["distance_m"] == (metres and pytest.approx(metres))
    # What is measured long after, beyond missing frames, says nothing of the status.
    late = KnownDistances({22: 7.8})
    assert figures(status, late, 5.0)["distance_frame"] == 22
    gap = [*10 * [0], 1, *29 * [0]]
    assert figures(status, late, 5.0, gap)["enough"] is None


def test_false_statuses_an_hour_have_exact_bounds_of_frames_and_of_blocks():
    found = false_status_per_hour(0, 99, 0, 5, 5.0)
    assert (found["in_frames"], found["false_status"]) == (18_000, 0)
    assert np.isclose(found["upper_bound"]["of_frames"], 18_000 * (1 - 0.05 ** (1 / 99)))
    assert np.isclose(found["upper_bound"]["of_blocks"], 900 * (1 - 0.05 ** (1 / 5)))
    found = false_status_per_hour(3, 60, 1, 3, None)
    assert (found["rate_fps"], found["in_frames"], found["false_status"]) == (None, 1000, 50)
    assert found["upper_bound"]["blocks"] == 50
    assert false_status_per_hour(0, 0, 0, 0, 5.0) is None


def test_times_of_a_log_and_a_log_of_other_frames(tiny, no_progress):
    mission = open_mission(tiny.path)
    mark = pixel_mark(mission.read(3))
    log = {n: LoggedDistance(n / 4, 20.0 - n, mark if n == 3 else "-") for n in range(3, 30)}
    stated = AtSea(log=log)
    assert stated.frames_per_second == 4
    found = known_distances(mission, [(8, 20)], stated, no_progress)
    assert np.isclose(found.closing_m_s(12), 4.0)
    assert AtSea(rate=2, log=log).frames_per_second == 2
    assert np.isclose(
        known_distances(mission, [], AtSea(2, log=log), no_progress).closing_m_s(12), 2.0
    )
    backwards = {n: LoggedDistance(-n / 4, 9.0, mark) for n in range(3, 30)}
    assert AtSea(log=backwards).frames_per_second is None
    for other in ({4: LoggedDistance(None, 9.0, mark)}, {999: LoggedDistance(None, 9.0, mark)}):
        said = "the log is not of the frames of mission 'tiny'"
        refuses(said, known_distances, mission, [], AtSea(log=other), no_progress)


def test_a_run_s_log_gives_the_distances(done, refused, tiny, tiny_bundle, tiny_truth, tmp_path):
    log = tmp_path / "run.jsonl"
    done(
        "run", "--bundle", tiny_bundle, "--source", tiny.path, "--log", log, "--udp", "127.0.0.1:9"
    )
    on = ("evaluate", tiny_bundle, "--mission", tiny.path, "--labels", tiny.labels, "--log", log)
    refused("its last run measured no distance", *on)
    lines = [json.loads(line) for line in log.read_text("utf-8").splitlines()]
    for line in lines:
        line["distance_m"] = 10 - line["frame"] / 8 if line["frame"] else None
    log.write_text("".join(json.dumps(line) + "\n" for line in lines), "utf-8")
    asked = (*on, "--rate", 4, "--stopping-distance", 5)
    frames = json.loads(done(*asked, "--json").out)["frames"]
    tower = [frame for frame in range(1, 41) if tiny_truth.cells(frame)]
    one = frames["approaches"][0]
    assert one["first_obstacle_frame"] == tower[0]
    assert one["distance_m"] == 10 - one["first_status"] / 8
    assert np.isclose(one["closing_m_s"], 0.5) and one["stopping_distance_m"] == 5
    assert one["enough"] is (one["distance_m"] >= 5)
    hourly = frames["false_status_per_hour"]
    assert hourly["in_frames"] == 14_400
    assert np.isclose(
        hourly["false_status"] * frames["ocean_frames"], 14_400 * frames["false_status"]
    )
    out = done(*asked).out
    assert f"approach {tower[0]}-" in out and "an hour at 4 frames a second" in out


def test_what_is_stated_of_a_dive_makes_sense(
    refused, tiny, own_tiny, tiny_bundle, tiny_truth, tmp_path
):
    rig = tmp_path / "rig.yml"
    write_calibration(rig, PLAIN)
    on = ("evaluate", tiny_bundle, "--mission", tiny.path)
    one = (*on, "--labels", tiny.labels)
    refused("a stopping distance needs distances", *one, "--stopping-distance", 3)
    refused("has no right camera", *one, "--calibration", rig)
    shutil.copytree(tiny.path / "Left", own_tiny.path / "Right")
    paired = ("evaluate", tiny_bundle, "--mission", own_tiny.path, "--labels", tiny.labels)
    refused("the calibration is for 1360x1024", *paired, "--calibration", rig)
    rows = [row for name in ("tiny", "b") for row in tiny_truth.labels(name)]
    both = ("--labels", tiny_truth.write_labels(tmp_path / "l.csv", rows))
    also = ("--mission", f"b={tiny.path}", "--log", tmp_path / "l.jsonl")
    refused("--log goes with one mission", *on, *also, *both)


@pytest.mark.mission
def test_the_sea_trial_s_distances(mission_dir, no_progress):
    """Of a model whose first status is the first obstacle frame."""
    rig = load_calibration(mission_dir.parent / "calibration.yml")
    mission, stated = open_mission(mission_dir), AtSea(5, 9.0, rig)
    found = known_distances(mission, [(140, 150)], stated, no_progress)
    assert min(found.distance_m) >= 140
    frames = list(range(95, 151))
    status = [int(n >= 140) for n in frames]
    (one,) = approach_figures(frames, [0] * 56, status, [(140, 150)], found, 9.0)
    assert (one["first_status"], one["frames_late"], one["enough"]) == (140, 0, True)
    assert 9.3 < one["distance_m"] < 10.2 and 140 <= one["distance_frame"] <= 142
    assert 0.6 < one["closing_m_s"] < 1.3
