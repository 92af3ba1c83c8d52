"""The bench's stereo cases: the thesis's pipeline as it was, and checks that can fail."""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.features.kernels.each_kernel import changed
from tests.inference.stereo.plain_rig import HEIGHT, PLAIN, WIDTH, specks
from tokt.features.frames.image_file import read_image
from tokt.features.frames.mission import open_mission
from tokt.features.kernels.dispatch import LIBRARY, load_kernels
from tokt_studies.baselines.thesis_stereo import judge_pair
from tokt_studies.speed import stereo_cases
from tokt_studies.speed.cases import textured_frame
from tokt_studies.speed.paired_timing import BenchRequest, BenchSize, single_thread
from tokt_studies.speed.report import print_table
from tokt_studies.speed.stereo_cases import Pair, StereoPair, measure_stereo, stereo_input

ONE_ROUND = BenchSize(compared=None, timed=2, rounds=1, files=0, tables=0, starts=0, latency=0)


def flat(seed):
    """Water in a lamp's light: enough of a picture to be judged, and nothing to match."""
    rows, columns = np.indices((HEIGHT, WIDTH), np.float64)
    fall = 8 + 25 * np.exp(-((columns - 560) ** 2 + (rows - 600) ** 2) / (2 * 400**2))
    rng = np.random.default_rng(seed)
    fine, uneven = (rng.normal(0, sd, fall.shape) for sd in (2.0, 5.0))
    view = fall + cv2.GaussianBlur(fine, (0, 0), 0.9) + cv2.GaussianBlur(uneven, (0, 0), 6)
    view += specks(rng, HEIGHT, WIDTH, grey_levels=5.0)
    return view.round().clip(0).astype(np.uint8)


@pytest.fixture(scope="module")
def pair():
    """A textured square 3.3 m away, in water."""
    left, right = flat(1), flat(2)
    texture = textured_frame()[:320, :320, 0] // 2
    left[350:670, 700:1020], right[350:670, 500:820] = texture, texture
    return Pair(2, left, right)


@pytest.fixture(scope="module")
def dive(pair, tmp_path_factory):
    """Four pairs: water, the square, a right frame that is broken, water that is black."""
    folder = tmp_path_factory.mktemp("stereo") / "dive"
    black = np.zeros((HEIGHT, WIDTH), np.uint8)
    water, square = (flat(3), flat(4)), (pair.left, pair.right)
    views = {1: water, 2: square, 3: (black, black), 4: (black, black)}
    for side, name in enumerate(("Left", "Right")):
        (folder / name).mkdir(parents=True)
        for number, pictures in views.items():
            cv2.imwrite(str(folder / name / f"d_{number}.png"), pictures[side])
    (folder / "Right" / "d_3.png").write_bytes(b"no picture")
    return folder


def test_the_thesis_pipeline_is_a_texture_threshold_on_the_left_frame(pair):
    """What the mission's control found: exchange the right frame, and nothing changes."""
    seen, without = judge_pair(pair.left, pair.right), judge_pair(pair.left, flat(9))
    assert seen.obstacle and without.mean == pytest.approx(seen.mean, rel=0.5)
    assert without.obstacle and not judge_pair(flat(1), pair.right).obstacle
    assert seen.verdict.x is not None  # of the cropped frame, 960 wide; the square's is 660
    assert abs(480 - seen.verdict.x - 660) < 80
    colour = judge_pair(cv2.cvtColor(pair.left, cv2.COLOR_GRAY2BGR), pair.right)
    assert colour.mean == seen.mean


@pytest.mark.mission
def test_the_thesis_pipeline_gives_the_means_that_were_measured(mission_dir):
    """Those of another port of it, by frame; the first of three over its threshold is 155."""
    with (mission_dir.parent / "thesis_port_curves.csv").open() as handle:
        table = {int(row["# frame"]): float(row["disp"]) for row in csv.DictReader(handle)}
    for number in (154, 155, 180, 212):
        files = (f"{side}/tokt1_{side[0]}_{number}.jpg" for side in ("Left", "Right"))
        found = judge_pair(*(read_image(mission_dir / file) for file in files))
        assert found.mean == pytest.approx(table[number], rel=1e-4)
        assert found.obstacle == (number in (155, 180))


def test_other_matches_than_the_library_s_are_not_exact(pair, monkeypatch):
    library = load_kernels(LIBRARY)

    def one_off(*arguments, **named):
        disparity = library.block_disparity(*arguments, **named).copy()
        disparity[250, 430] += 1  # a sixteenth of a pixel
        return disparity

    right = StereoPair(PLAIN)
    assert not right.exact  # nothing has been looked at yet
    wrong_kernels = changed(library, block_disparity=one_off)
    monkeypatch.setattr(stereo_cases, "load_kernels", lambda _: wrong_kernels)
    wrong = StereoPair(PLAIN)
    for case in (right, wrong):
        assert case.check(pair)
    assert right.exact and not wrong.exact
    assert wrong.findings()["pairs_different"] == 1
    assert right.findings()["obstacle_pairs"] == {"baseline": 1, "ours": 1}


def test_both_cases_of_a_mission(dive, no_progress, capsys):
    asked = BenchRequest(dive, None, PLAIN, ONE_ROUND, no_progress, str)
    with single_thread():
        results = measure_stereo(open_mission(dive), PLAIN, asked)
    assert [case.name for case in results] == ["stereo.pair", "pushbroom.pair"]
    stereo = results[0].to_json()
    # The black pair is refused, and not timed: it would flatter.
    assert (stereo["pairs_checked"], stereo["pairs_refused"], stereo["repetitions"]) == (2, 1, 2)
    assert stereo["obstacle_pairs"]["ours"] == 1 and stereo["exact"]
    for kind in ("with_obstacle", "without_obstacle"):
        assert stereo[kind]["pairs"] == 1 and stereo[kind]["baseline_ms"] > 0
    packages = ("python", "numpy", "opencv", "scikit-image", "mahotas", "scikit-learn")
    about = {
        "machine": dict.fromkeys(packages, "1") | {"cpu": "one", "cores": 1},
        "kernels": {"name": "compiled", "why": "built", "is_library": False},
        **{"mission": "dive", "frame_size": "1360x1024 gray", "model": "none"},
        **{"frames": {"compared": 2, "timed": 2}, "spread_is": "wide"},
        "stereo": "calibration given",
        "video_mb": None,
    }
    print_table(results, about)
    table = capsys.readouterr().out
    assert "(ours) of 2 pairs" in table and "without obstacle:" in table
    assert "exact: ours matches" in table and "exact: depths are within" in table
    assert "stereo: calibration given" in table


def test_without_what_stereo_needs_the_cases_are_left_out_and_it_is_said(dive, tmp_path):
    mission = open_mission(dive)
    assert stereo_input(mission, PLAIN).calibration is PLAIN
    assert "there is no calibration.yml" in stereo_input(mission, None).words
    small = replace(PLAIN, frame_size=(680, 512))
    assert "1360x1024" in stereo_input(mission, small).words
    (tmp_path / "mono" / "Left").mkdir(parents=True)
    cv2.imwrite(str(tmp_path / "mono" / "Left" / "m_1.png"), flat(1)[:20, :20])
    (tmp_path / "mono" / "calibration.yml").write_text("no calibration")
    mono = open_mission(tmp_path / "mono")
    broken = stereo_input(mono, None)
    assert broken.calibration is None and "calibration.yml" in broken.words
    assert stereo_input(mono, PLAIN).words == "left out: it has no right camera"
