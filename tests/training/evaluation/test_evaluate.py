"""`tokt evaluate`: its figures against a count by hand, for binary and several-class models."""

import json
from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest
from scipy import stats

from tokt.features.frames.mission import open_mission
from tokt.inference.reason import Reason
from tokt.models.bundle.bundle import bundle_bytes, read_bundle
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.training.evaluation.evaluate import first_detection
from tokt.training.evaluation.metrics import reliability, right_by_margin


@pytest.fixture
def evaluate(done, tiny):
    def run(model, *more, mission=None, labels=None):
        on = ("--mission", mission or tiny.path, "--labels", labels or tiny.labels)
        ran = done("evaluate", model, "--json", *on, *more)
        return json.loads(ran.out), ran.err

    return run


def test_counts_are_those_of_a_count_by_hand(evaluate, tiny_bundle, tiny, tiny_truth):
    bundle, mission = read_bundle(tiny_bundle), open_mission(tiny.path)
    counts = dict.fromkeys(("hit", "false", "missed", "quiet"), 0)
    alarms = []
    for frame in range(1, 41):
        values = bundle.decision_values(mission.read(frame)).reshape(10, 10)
        if (values > bundle.operating_point.rule.margin).any():
            alarms.append(frame)
        for row, col in product(range(10), range(10)):
            true = (row, col) in tiny_truth.cells(frame)
            if not true and row == 2 and (3, col) in tiny_truth.cells(frame):
                continue  # unsure
            said = values[row, col] > 0
            key = ("hit" if true else "false") if said else ("missed" if true else "quiet")
            counts[key] += 1
    result, _ = evaluate(tiny_bundle)
    patch, frames = result["patch"], result["frames"]
    names = ("true_positive", "false_positive", "false_negative", "true_negative")
    assert list(counts.values()) == [patch[name] for name in names]
    assert np.isclose(patch["precision"], counts["hit"] / (counts["hit"] + counts["false"]))
    assert np.isclose(patch["recall"], counts["hit"] / (counts["hit"] + counts["missed"]))
    tower = [frame for frame in range(1, 41) if tiny_truth.cells(frame)]
    ocean = [frame for frame in range(1, 41) if not tiny_truth.cells(frame)]
    assert frames["n"] == 40
    assert frames["obstacle_frames"] == len(tower)
    assert frames["ocean_frames"] == len(ocean)
    assert frames["detected"] == len(set(tower) & set(alarms))
    assert frames["false_status_frames"] == sorted(set(ocean) & set(alarms))
    assert frames["false_status"] == len(frames["false_status_frames"])
    in_a_row = [n for n in range(1, 39) if {n, n + 1, n + 2} <= set(alarms)]
    assert frames["first_detection"] == in_a_row[0]
    assert result["unsure_ignored"] == 2 * len(tower)


def test_frames_are_judged_at_the_operating_point_across_a_gap(
    evaluate, tiny_bundle, tiny, tiny_truth, tmp_path
):
    """2 of 3 frames with 2 patches above a margin; frames 15 to 17 are not looked at."""
    bundle, mission = read_bundle(tiny_bundle), open_mission(tiny.path)
    tower = [frame for frame in range(1, 41) if tiny_truth.cells(frame)]
    wanted = [frame for frame in range(1, 41) if not 15 <= frame <= 17]
    scores = {frame: bundle.decision_values(mission.read(frame))[:, 0] for frame in wanted}
    margin = float(np.quantile([np.sort(scores[f])[-2] for f in tower if f in wanted], 0.1))
    point = OperatingPoint(MofNRule(margin, 2, 2, 3), {"target_rate": 1e-4})
    file = tmp_path / "ruled.tokt"
    file.write_bytes(bundle_bytes(replace(bundle.content, operating_point=point)))
    status = {}
    for frame in wanted:
        last = [number for number in (frame - 2, frame - 1, frame) if number in wanted]
        times = np.sum([scores[number] > margin for number in last], axis=0)
        possible = (times > 0) & (times + 3 - len(last) >= 2)
        status[frame] = 1 if (times >= 2).sum() >= 2 else -1 if possible.sum() >= 2 else 0
    assert {status[frame] for frame in tower if frame in wanted} == {1, 0, -1}

    result, _ = evaluate(file, "--frames", "1-14,18-40")

    frames, plain = result["frames"], evaluate(tiny_bundle, "--frames", "1-14,18-40")[0]
    seen = [frame for frame in tower if status.get(frame) == 1]
    assert frames["missed_frames"] == sorted(set(tower) & set(wanted) - set(seen))
    assert frames["detected"] == len(seen) < plain["frames"]["detected"]
    assert frames["unknown"] == list(status.values()).count(-1) > 0
    said = [frame for frame in wanted if frame not in tower and status[frame] == 1]
    held = [
        frame
        for frame in said
        if not (scores[frame] > margin).any() and {frame - 2, frame - 1} & set(tower) & set(wanted)
    ]
    assert frames["held_status_frames"] == held != []
    assert frames["held_status"] == len(held)
    assert frames["false_status_frames"] == sorted(set(said) - set(held))
    assert frames["false_status"] == len(said) - len(held)
    assert result["patch"] == plain["patch"]
    assert result["operating_point"] == point.to_json()
    assert (result["latency_frames"], plain["latency_frames"]) == (1, 0)
    assert plain["frames"]["held_status_frames"] == []


@pytest.fixture(scope="module")
def listed(tiny_dive, tmp_path_factory):
    """A list of three dives of 24 frames at two sites, each with its own labels and pictures."""
    place = tmp_path_factory.mktemp("dives")
    for name, gain in (("a", 1.0), ("b", 1.1), ("c", 1.2)):
        tiny_dive(place / name, range(1, 25), gain)
    text = "".join(
        f'[[mission]]\nname = "{name}"\ndir = "{name}"\nlabels = "{name}/labels.csv"\n'
        f'site = "{site}"\ndate = 2016-04-20\n'
        for name, site in (("a", "fjord"), ("b", "basin"), ("c", "basin"))
    )
    file = place / "missions.toml"
    file.write_text(text, "utf-8")
    return file


def test_several_missions_by_dive_and_site(done, refused, evaluate, tiny_bundle, listed):
    found = json.loads(done("evaluate", tiny_bundle, "--mission", listed.parent, "--json").out)
    alone = {
        name: evaluate(
            tiny_bundle, mission=listed.parent / name, labels=listed.parent / name / "labels.csv"
        )[0]
        for name in "abc"
    }
    assert alone["a"]["patch"]["n"] * 3 == found["patch"]["n"]
    for one in found["missions"]:
        name = one["mission"]
        assert one["site"] == {"a": "fjord"}.get(name, "basin")
        for key in ("patch", "frames", "unsure_ignored", "seen_in_training"):
            assert one[key] == alone[name][key]
    counts = ("true_positive", "false_positive", "false_negative", "true_negative")
    for names, pooled in (
        ("abc", found),
        ("a", found["sites"]["fjord"]),
        ("bc", found["sites"]["basin"]),
    ):
        for key in counts:
            assert pooled["patch"][key] == sum(alone[name]["patch"][key] for name in names)
        for key in ("n", "ocean_frames", "false_status", "obstacle_frames", "detected", "unknown"):
            assert pooled["frames"][key] == sum(alone[name]["frames"][key] for name in names)
        first = {name: alone[name]["frames"]["first_detection"] for name in names}
        assert pooled["frames"]["first_detection"] == first
        coming = [{"mission": n, **at} for n in names for at in alone[n]["frames"]["approaches"]]
        assert pooled["frames"]["approaches"] == coming != []
        hourly = pooled["frames"]["false_status_per_hour"]
        assert hourly["false_status"] * pooled["frames"]["ocean_frames"] == pytest.approx(
            1000 * pooled["frames"]["false_status"]
        )
        missed = [f"{n}:{at}" for n in names for at in alone[n]["frames"]["missed_frames"]]
        assert pooled["frames"]["missed_frames"] == missed
    assert "mission" not in found and found["seen_in_training"] == 24
    command = ("evaluate", tiny_bundle, "--mission", listed.parent)
    refused("--frames goes with one mission", *command, "--frames", "1-8")


def test_three_in_a_row_do_not_reach_over_a_gap():
    def first(missed, status):
        return first_detection(list(range(10, 10 * len(missed) + 1, 10)), missed, status)

    assert first([0, 0, 0, 0], [0, 1, 1, 1]) == 20
    assert first([0, 0], [1, 1]) is first([0] * 5, [1, 1, -1, 1, 1]) is None
    assert first([0, 0, 13], [1, 1, 1]) is None
    assert first([0, 0, 13, 0, 0], [1, 1, 1, 1, 1]) == 30


def test_registered_model_and_exported_bundle_agree_exactly(evaluate, trained, tiny_bundle):
    from_registry, _ = evaluate("tiny-lbp@challenger", "--workspace", trained)
    from_file, _ = evaluate(tiny_bundle)
    assert from_registry == from_file
    # Keys that scripts use.
    assert {"patch", "frames", "unsure_ignored", "model"} <= set(from_file)
    patch = ("precision", "recall", "f1", "average_precision", "per_class")
    assert set(patch) <= set(from_file["patch"])
    frames = ("n", "ocean_frames", "false_status", "detected", "obstacle_frames", "first_detection")
    assert set(frames) <= set(from_file["frames"])
    assert set(from_file["patch"]["per_class"]) == {"clear", "obstacle"}


def test_frames_learnt_from_are_warned_of(evaluate, tiny_bundle, own_tiny, tiny_truth):
    result, err = evaluate(tiny_bundle, "--frames", "1-8")
    assert result["seen_in_training"] == 8
    assert "WARNING: the model learnt from 8 of these frames" in err
    for number in range(1, 41):
        noisy = tiny_truth.draw(number) + np.uint8(1)
        cv2.imwrite(str(own_tiny.path / "Left" / f"tiny_L_{number}.png"), noisy)
    result, err = evaluate(tiny_bundle, mission=own_tiny.path)
    assert result["seen_in_training"] == 0
    assert "WARNING" not in err


def test_a_frame_without_labels_is_no_training_figure(
    evaluate, refused, tiny_bundle, own_tiny, tiny_truth, tmp_path
):
    for number in (3, 30):
        noisy = tiny_truth.draw(number) + np.uint8(1)
        cv2.imwrite(str(own_tiny.path / "Left" / f"tiny_L_{number}.png"), noisy)
    rows = [row for row in tiny_truth.labels() if row[2] in (3, 30)]
    labels = tiny_truth.write_labels(tmp_path / "new.csv", rows)
    result, err = evaluate(tiny_bundle, mission=own_tiny.path, labels=labels)
    assert result["seen_in_training"] == 0 and "WARNING" not in err
    assert result["patch"]["n"] == sum(row[-1] != "unsure" for row in rows)
    options = ("--mission", own_tiny.path, "--labels", labels)
    said = refused("not 41-43", "evaluate", tiny_bundle, *options, "--frames", "30-43")
    assert "mission tiny has frames 1-40" in said


def test_partly_labelled_and_unsure_frames_are_not_judged(
    evaluate, tiny_bundle, tiny_truth, tmp_path
):
    rows = [row for row in tiny_truth.labels() if row[2] in (1, 2, 3)]  # ocean frames
    rows.pop()  # frame 3 lacks a patch
    rows[150][-1] = "unsure"  # of frame 2
    labels = tiny_truth.write_labels(tmp_path / "l.csv", rows)
    result, _ = evaluate(tiny_bundle, labels=labels)
    assert result["frames"]["ocean_frames"] == 1
    assert result["frames"]["not_judged"] == 39
    assert result["patch"]["n"] == 298
    assert result["patch"]["recall"] is None
    assert result["patch"]["average_precision"] is None


def test_a_frame_the_runtime_cannot_judge_is_no_correct_clear(evaluate, tiny_bundle, own_tiny):
    before, _ = evaluate(tiny_bundle, mission=own_tiny.path, labels=own_tiny.labels)
    dark = open_mission(own_tiny.path).file(1, "left")
    cv2.imwrite(str(dark), np.zeros_like(open_mission(own_tiny.path).read(1)))
    after, _ = evaluate(tiny_bundle, mission=own_tiny.path, labels=own_tiny.labels)
    assert before["frames"]["unknown"] == 0
    assert after["frames"]["unknown"] == 1
    assert after["seen_in_training"] == before["seen_in_training"] - 1
    assert after["mission_in_training"] is True


def test_ready_cut_patches(done, refused, cut_patches, cut, tiny_bundle, tmp_path):
    space, other = ("--workspace", cut.workspace), cut_patches(tmp_path / "other", 2, 20)
    command = ("evaluate", "cut-lbp", *space, "--patches")
    ran = done(*command, other, "--json")
    assert "WARNING" not in ran.err
    found = json.loads(ran.out)
    patch = found["patch"]
    assert (patch["n"], found["unsure_ignored"], found["seen_in_training"]) == (40, 20, 0)
    done("export", "cut-lbp", "-o", tmp_path / "cut.tokt", *space)
    bundle = read_bundle(tmp_path / "cut.tokt")
    said = {
        label: [
            bundle.decision_values(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)).item() > 0
            for file in (other / label).iterdir()
        ]
        for label in ("ocean", "reef")
    }
    assert patch["true_positive"] == sum(said["reef"]) > 15
    assert patch["false_positive"] == sum(said["ocean"]) < 5
    assert set(patch["by_label"]) == {"ocean", "reef"}
    assert sum(one["n"] for one in patch["reliability"]) == 40
    assert "learnt from 40 of these patches" in done(*command, cut.patches).err
    out = done(*command, other).out
    assert "reef: " in out and "status" not in out
    refused("judges the patches of whole frames", "evaluate", tiny_bundle, "--patches", other)
    refused("go with --mission", *command, other, "--frames", "1-2")
    (other / "reef" / "1.png").write_bytes(b"no image")
    refused("1.png", *command, other)


def test_how_often_patches_are_what_they_are_called_by_margin():
    score = np.concatenate([np.full(100, -0.05), np.full(40, -4.0), np.full(60, 0.3), [0.6] * 29])
    truth = np.concatenate([np.arange(100) < 55, np.zeros(40), np.arange(60) >= 3, np.ones(29)]) > 0
    close, far, hit = right_by_margin(truth, score)  # 29 patches say nothing
    assert close == {"obstacle": False, "low": 0.0, "high": 0.1, "n": 100} | {
        "right": pytest.approx(0.45),
        "at_least": pytest.approx(stats.beta.ppf(0.05, 45, 56)),
    }
    assert (far["low"], far["high"], far["right"]) == (3.0, None, 1.0)
    assert far["at_least"] == pytest.approx(0.05 ** (1 / 40))
    assert (hit["obstacle"], hit["low"], hit["n"]) == (True, 0.25, 60)
    assert right_by_margin(truth[:0], score[:0]) == []


def test_how_often_patches_are_obstacles_by_decision_value():
    score = np.array([-3.0, -2, -1, -0.5, -0.4, -0.3, -0.1, 0, 0.5, 1, 2])
    truth = np.array([0, 0, 0, 0, 1, 0, 0, 1, 0, 1, 1], bool)
    rng = np.random.default_rng(1)
    order = rng.permutation(len(score))
    found = reliability(truth[order], score[order])
    assert [(one["low"], one["high"], one["n"]) for one in found] == [
        *((-3.0, -2.0, 2), (-1.0, -0.5, 2), (-0.4, -0.3, 2), (-0.1, -0.1, 1), (0.0, 0.0, 1)),
        *((0.5, 0.5, 1), (1.0, 1.0, 1), (2.0, 2.0, 1)),
    ]
    assert [one["obstacle"] for one in found] == [0, 0, 0.5, 0, 1, 0, 1, 1]
    assert reliability(truth[:2], np.array([np.inf, np.inf])) == []
    assert [one["n"] for one in reliability(truth[:3], score[-3:])] == [1, 1, 1]


def test_unknown_frames_are_told_by_reason_and_what_to_do(done, tiny_bundle, own_tiny):
    """F1 says nothing of a frame that a run does not judge: the reasons stand beside it."""
    frames = sorted((own_tiny.path / "Left").iterdir()) if (own_tiny.path / "Left").is_dir() else []
    files = frames or sorted(own_tiny.path.glob("*.png"))
    for path in files:
        cv2.imwrite(str(path), np.zeros_like(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))
    on = ("--mission", own_tiny.path, "--labels", own_tiny.labels)
    ran = done("evaluate", tiny_bundle, *on)
    assert "obstacle seen in 0 of" in ran.out
    assert "of the others are unknown, whatever their patches say" in ran.out
    assert "status unknown in 40 of 40 frames\n    unknown: 40 dark\n" in ran.out
    assert f"dark: {Reason.DARK.meaning} {Reason.DARK.advice}" in ran.out
    told = json.loads(done("evaluate", tiny_bundle, "--json", *on).out)["frames"]
    assert told["unknown_reasons"] == {"dark": 40}
    assert told["missed_unknown"] == told["obstacle_frames"]
