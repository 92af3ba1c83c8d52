"""`tokt bench`: every case is there, and wrong kernels are not called exact. No speed is tested."""

import json
import math
import sys
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.calls import refused, refuses, succeeds
from tests.features.kernels.each_kernel import changed
from tokt.features.frames.mission import open_mission
from tokt.features.kernels.dispatch import KERNELS, load_kernels
from tokt.inference.policy.policy import Judgement
from tokt.inference.verdict import verdict_from_mask
from tokt_studies.baselines.thesis_texture import GRID, haralick_directions
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt_studies.speed.cases import HaralickKernel, LbpKernel, MovingFrame, Picture, WholeFrame
from tokt_studies.speed.haralick_agreement import HaralickAgreement
from tokt_studies.speed.models import FEATURE_SETS, examples_from_two_images, fit_extractor_pair
from tokt_studies.speed.paired_timing import BASELINE, OURS, BenchSize, in_turns
from tokt_studies.speed.process_cases import first_verdict
from tokt_studies.speed.report import about_lines
from tokt_studies.speed.video_memory import ENCODERS, NETWORK, can_be_measured

FRAME_CASES = ["lbp_10_5.frame", "lbp_24_8.frame", "haralick.frame"]
CASES = [
    *("lbp_10_5.kernel", "lbp_24_8.kernel", "haralick.kernel", "haralick_texture.kernel"),
    *(*FRAME_CASES, "best.frame", "water.frame", "moving.frame"),
    *("run.default", "latency.frame_to_udp"),
    *("extract.dataset", "extract.dataset_all_cores", "start"),
]
ONE_OF_EACH = BenchSize(compared=1, timed=1, rounds=1, files=1, tables=1, starts=1, latency=1)
"""Enough where no figure is looked at."""


@pytest.fixture(scope="module", autouse=True)
def coarse_figures():
    """None: pixels are looked at."""


@pytest.fixture(scope="module")
def sea(tmp_path_factory):
    """A small rendered mission; every fifth frame of it shows both water and the tower."""
    folder = tmp_path_factory.mktemp("bench") / "sea"
    simulate_mission(folder, n_frames=16, width=360)
    return folder


@pytest.fixture(scope="module")
def picture(sea):
    """A frame close to the tower."""
    return Picture(open_mission(sea).read(9))


def check_every_case_is_measured_and_exact(cases):
    assert [(case["name"], case["exact"]) for case in cases] == [(name, True) for name in CASES]
    for case in cases:
        assert case["baseline_ms"] > 0 and case["ours_ms"] > 0
        assert math.isclose(case["ratio"], case["baseline_ms"] / case["ours_ms"])
        assert 0 < case["spread"][0] <= case["spread"][1] < math.inf


def check_a_result_says_what_it_was_measured_on(found):
    assert found["kernels"]["name"] == KERNELS.name and found["mission"] == "sea"
    assert found["frame_size"] == "360x271 colour"
    assert found["frames"] == {"compared": 2, "timed": 1}
    assert set(found["machine"]) >= {"cpu", "cores", "python", "numpy", "opencv", "mahotas"}
    assert found["stereo"] == "left out: the thesis's pipeline is for frames of 1360x1024"
    assert "percentile" in found["spread_is"] and "labelled frames" in found["model"]
    cases = {case["name"]: case for case in found["cases"]}
    for name in FRAME_CASES:
        assert cases[name]["obstacle_patches"] > 0 and cases[name]["frames_checked"] == 2
        assert cases[name]["floor_ms"] > 0 and cases[name]["memory_ms"] > 0
    assert cases["haralick.kernel"]["max_relative_difference"] <= 1e-9
    assert cases["extract.dataset"]["ours_patches_per_s"] > 0
    assert cases["extract.dataset"]["floor_ms"] > 0
    latency = cases["latency.frame_to_udp"]
    assert 0 < latency["not_the_detector_median_ms"] < latency["ours_median_ms"]
    assert latency["ours_p99_ms"] <= latency["ours_max_ms"] and latency["repetitions"] == 1
    if can_be_measured():
        assert [*found["video_mb"]] == [*ENCODERS, NETWORK] and min(found["video_mb"].values()) > 30
    else:
        assert found["video_mb"] is None
    if sys.platform != "win32":
        assert cases["start"]["baseline_mb"] > 30 and cases["start"]["ours_mb"] > 20


def check_the_chart_is_a_picture(out):
    chart = cv2.imread(str(out / "bench.png"))
    assert chart is not None and min(chart.shape[:2]) > 400
    assert (out / "bench.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in out.iterdir()) == ["bench.json", "bench.png"]


def check_the_table_says_when_kernels_are_the_libraries(about):
    as_library = {**about["kernels"], "name": "library", "is_library": True}
    lines = "\n".join(about_lines({**about, "kernels": as_library}))
    assert "kernels: library" in lines and "ARE the libraries" in lines
    assert "ARE the libraries" not in "\n".join(about_lines(about))


def test_the_whole_bench(sea, tmp_path, monkeypatch):
    """One test, as two workers would each run the command for tests of their own."""
    monkeypatch.setattr("tokt_studies.speed.run.QUICK", replace(ONE_OF_EACH, compared=2))
    out = tmp_path / "bench"
    ran = succeeds("bench", "--quick", "--json", "--mission", sea, "--out", out)
    found = json.loads(ran.out)
    assert json.loads((out / "bench.json").read_text("utf-8")) == found
    check_every_case_is_measured_and_exact(found["cases"])
    check_a_result_says_what_it_was_measured_on(found)
    check_the_chart_is_a_picture(out)
    check_the_table_says_when_kernels_are_the_libraries(found)


@pytest.mark.mission
def test_the_real_missions_frames_are_judged_alike(mission_dir, run_tokt, tmp_path, monkeypatch):
    monkeypatch.setattr("tokt_studies.speed.run.QUICK", ONE_OF_EACH)
    # Whole processes and files are no other for these frames.
    monkeypatch.setattr("tokt_studies.speed.run._outside", lambda *_: [])
    # The models learn from every fifth labelled frame: from four, of these.
    labels = tmp_path / "labels.csv"
    head, *rows = (mission_dir / "labels.csv").read_text().splitlines(keepends=True)
    labels.write_text(head + "".join(row for row in rows if int(row.split(",")[2]) % 10 == 0))
    monkeypatch.setattr("tokt_studies.speed.stereo_cases.COMPARED_PAIRS", 1)
    options = ("--quick", "--frames", 4, "--mission", mission_dir, "--out", tmp_path / "out")
    files = ("--labels", labels, "--calibration", mission_dir.parent / "calibration.yml")
    ran = run_tokt("bench", "--json", *options, *files)
    found = json.loads(ran.out)
    assert [case["name"] for case in found["cases"] if not case["exact"]] == []
    assert ran.code == 0 and found["frame_size"] == "1360x1024 colour"
    frames = [case for case in found["cases"] if "obstacle_patches" in case]
    assert [case["name"] for case in frames] == FRAME_CASES
    assert all(case["obstacle_patches"] > 10 and case["ties"] == 0 for case in frames)
    assert [case["name"] for case in found["cases"][-2:]] == ["stereo.pair", "pushbroom.pair"]
    assert found["stereo"] == "calibration given"


def test_labels_that_do_not_fit(sea, tmp_path, tiny_truth):
    rows = [["sea", "left", 999, 0, 0, "ocean"]]
    labels = tiny_truth.write_labels(tmp_path / "other.csv", rows)
    asked = ("bench", "--mission", sea, "--out", tmp_path / "out", "--labels")
    assert refused("999", *asked, labels).count("\n") == 1
    rows = [["sea", "left", 1, 0, 0, "ocean"]]
    labels = tiny_truth.write_labels(tmp_path / "clear.csv", rows)
    refused("both obstacles and clear water", *asked, labels)
    assert not (tmp_path / "out").exists()


def test_counts_off_by_one_are_not_exact(picture):
    library = load_kernels("library")

    def off_by_one(*arguments, **named):
        counts = library.lbp_counts(*arguments, **named)
        counts[-1, 0] += 1
        return counts

    right = LbpKernel("right", 10, 5, library)
    wrong = LbpKernel("wrong", 10, 5, changed(library, lbp_counts=off_by_one))
    assert not right.exact  # nothing has been looked at yet
    for case in (right, wrong):
        case.check(picture)
    assert right.exact and not wrong.exact
    assert wrong.findings()["patches_different"] == 1
    assert not wrong.measure([picture], 1).to_json()["exact"]


def test_the_libraries_features_are_exact(picture):
    case = HaralickKernel("right", load_kernels("library"))
    case.check(picture)
    assert case.exact and case.findings()["max_relative_difference"] == 0


@pytest.fixture(scope="module")
def directions(picture):
    """What mahotas says of each patch of the picture: it is needed for every feature."""
    asked = product(picture.patches, (False, True))
    return {(patch.tobytes(), zeros): haralick_directions(patch, zeros) for patch, zeros in asked}


@pytest.mark.parametrize("feature", [None, 0, 12])
def test_a_feature_that_is_a_little_wrong_is_not_exact(picture, directions, feature, monkeypatch):
    def known(patch, ignore_zeros):
        return directions[patch.tobytes(), ignore_zeros]

    def a_little_wrong(gray, grid, ignore_zeros, threads):
        features = np.stack([known(p, ignore_zeros).mean(axis=0) for p in picture.patches])
        if feature is not None:
            features[45, feature] *= 1 + 1e-7
        return features

    monkeypatch.setattr("tokt_studies.baselines.thesis_texture.haralick_directions", known)
    kernels = changed(load_kernels("library"), haralick_features=a_little_wrong)
    case = HaralickKernel("wrong", kernels)
    case.check(picture)
    assert case.exact == (feature is None)


def test_constant_patches_have_an_undetermined_correlation_only():
    directions = haralick_directions(np.full((27, 36), 200, np.uint8), ignore_zeros=True)
    agreement = HaralickAgreement()
    agreement.add(directions.mean(axis=0), directions)
    assert agreement.agree and agreement.compared > 0
    other = directions.mean(axis=0)
    other[1] = 1e-6  # contrast is 0 exactly
    agreement.add(other, directions)
    assert not agreement.agree


@pytest.fixture(scope="module")
def two_images(sea):
    mission = open_mission(sea)
    texture, examples = FEATURE_SETS[0], examples_from_two_images(mission)
    return fit_extractor_pair(texture.name, texture.extractor, examples, mission.read(1))


def test_a_verdict_from_other_weights_is_not_exact(two_images, picture):
    """Two images teach the model that texture is an obstacle; the other side gets it reversed."""
    right = WholeFrame(FEATURE_SETS[0], two_images)
    right.check(picture)
    assert right.exact
    classifier = two_images.classifier
    reversed_one = type(classifier)()
    reversed_one.__dict__.update(classifier.__dict__)
    reversed_one.coef_, reversed_one.intercept_ = -classifier.coef_, -classifier.intercept_
    wrong = WholeFrame(FEATURE_SETS[0], replace(two_images, classifier=reversed_one))
    wrong.check(picture)
    assert not wrong.exact and wrong.findings()["patches_different"] == GRID.n_patches


def test_frames_that_the_runtime_refuses_are_counted(two_images):
    case = WholeFrame(FEATURE_SETS[0], two_images)
    case.check(Picture(np.zeros((271, 360, 3), np.uint8)))
    assert case.findings()["frames_refused"] == 1 and not case.exact


def test_a_clear_that_the_runtime_takes_back_is_refused_and_no_difference(two_images, sea):
    frame = open_mission(sea).read(1).copy()
    frame[:, : frame.shape[1] * 2 // 3] = frame[:, -1:]  # most of the view shows nothing
    case = WholeFrame(FEATURE_SETS[0], two_images)
    case.check(Picture(frame))
    found = case.findings()
    assert found["frames_refused"] == 1 and found["patches_different"] == 0
    assert found["obstacle_patches"] == 0 and case.exact


def test_calls_are_timed_in_turns_on_the_same_items():
    seen = []
    calls = {name: lambda item, name=name: seen.append((name, item)) for name in (BASELINE, OURS)}
    times = in_turns(calls, [0, 1, 2, 3], rounds=2)
    warm, timed = seen[:2], seen[2:]
    assert warm == [(BASELINE, 0), (OURS, 0)]
    assert [name for name, _ in timed] == [BASELINE, OURS] * 8
    for name in calls:
        assert sorted(item for other, item in timed if other == name) == [0, 0, 1, 1, 2, 2, 3, 3]
    # No call gets the item that the other has just had in its hands.
    assert all(a[1] != b[1] for a, b in zip(timed[::2], timed[1::2], strict=True))
    assert all(values.shape == (8,) and (values >= 0).all() for values in times.values())


@pytest.mark.parametrize("sends", [True, False])
def test_a_program_that_fails_is_told(sends, tmp_path):
    def broken(port):
        program = "import socket, sys;"
        if sends:
            program += "s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM);"
            program += f"s.sendto(b'x', ('127.0.0.1', {port}));"
        return [sys.executable, "-c", f"{program} sys.exit('no model')"]

    refuses("ended with 1: no model", first_verdict, broken, tmp_path)


def test_flow_that_made_a_frame_clear_would_be_told(two_images, picture):
    case = MovingFrame(two_images.bundle)
    assert case.check(picture) and case.exact
    masks = (np.full((10, 10), level, np.uint8) for level in (255, 0))
    case._alone, case._moving = (
        SimpleNamespace(judge=lambda _, mask=mask: Judgement(verdict_from_mask(mask, "texture")))
        for mask in masks
    )
    case.check(picture)
    assert case.findings()["frames_made_clear"] == 1 and not case.exact
