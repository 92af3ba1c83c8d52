"""`tokt models promote`: what the gate lets through, what it refuses, and what is kept of it."""

import json
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.calls import call_tokt, refuses
from tokt.models.registry.registry import Registry
from tokt.training.compare.frames import FrameSeries
from tokt.training.compare.held_out_predictions import read_held_out
from tokt.training.compare.promotion import FALSE_STATUS, SEEN, judge_candidate

GOOD, BAD, SAME = "tiny-lbp/1", "tiny-lbp/2", "tiny-lbp/3"
ANY_TIME = ("--max-ms", 60_000)  # no test of time but one: the machine may be busy


@pytest.fixture(scope="module")
def three(trained, done, tmp_path_factory):
    """Three versions of one model: a good one, the thesis's, the good one again."""
    workspace = tmp_path_factory.mktemp("promotion") / ".tokt"
    shutil.copytree(trained, workspace)
    for preset in ("thesis", "plain"):
        options = ("--extractor", "lbp", "--preset", preset, "--name", "tiny-lbp", "--folds", 3)
        done("train", "tiny", *options, "--embargo", 1, "--workspace", workspace)
    return workspace


@pytest.fixture
def registered(three, tmp_path):
    """A copy of it, the registry, and the command on it."""
    workspace = tmp_path / ".tokt"
    shutil.copytree(three, workspace)

    def promote(*arguments):
        ran = call_tokt("models", "promote", *arguments, "--workspace", workspace)
        print(ran.out, ran.err)
        return ran

    return SimpleNamespace(path=workspace, registry=Registry(workspace), promote=promote)


def test_the_first_champion_has_nothing_to_beat_and_a_worse_one_is_refused(registered, told):
    ran = registered.promote(BAD)
    assert ran.code == 0 and f"{BAD} is now tiny-lbp@champion" in ran.out
    assert "note: there was no tiny-lbp@champion: nothing was compared" in ran.err
    assert registered.promote(GOOD, *ANY_TIME).code == 0
    assert registered.registry.find("tiny-lbp@champion").label == GOOD
    ran = registered.promote(BAD, *ANY_TIME)
    assert ran.code == 2 and ran.err.splitlines()[-1].startswith("tokt: error: ")
    assert "does not become tiny-lbp@champion: worse on dive tiny: F1" in ran.err
    assert re.search(
        r"tiny +F1 +\d\.\d{3} -> \d\.\d{3}  WORSE  by -\d\.\d{3} to -\d\.\d{3}\n", ran.out
    )
    assert registered.registry.find("tiny-lbp@champion").label == GOOD
    first, refused = registered.registry.find(BAD).promotions
    assert (first["outcome"], first["against"]) == ("promoted", "")
    assert (refused["outcome"], refused["against"]) == ("refused", GOOD)
    assert refused["faults"].startswith("worse on dive tiny: F1") and refused["who"]
    assert "dataset tiny@" in refused["what"]
    shown = told("models", "show", BAD, "--workspace", registered.path)
    assert shown["promotions"] == [first, refused]


def test_force_promotes_what_was_refused_and_keeps_why(registered, done):
    registered.promote(GOOD)
    ran = registered.promote(BAD, "--force", "the old one\nis for another camera", "--json")
    found = json.loads(ran.out)
    assert ran.code == 0 and found["outcome"] == "forced" and found["faults"]
    assert registered.registry.find("tiny-lbp@champion").label == BAD
    card = done("models", "show", BAD, "--workspace", registered.path).out
    said = (
        f"outcome forced; alias champion; against {GOOD}; what dataset .*; why the old one is for"
    )
    assert re.search(said, card)
    # The bundle is what it was.
    assert registered.registry.bundle(BAD).name == "tiny-lbp"


def test_one_that_is_as_good_passes_and_a_slow_one_does_not(registered):
    registered.promote(GOOD)
    ran = registered.promote(SAME, "--max-ms", 1e-6, "--json")
    found = json.loads(ran.out)
    assert ran.code == 2 and len(found["faults"]) == 1 and found["outcome"] == "refused"
    assert "ms a frame, more than 0.00" in ran.err
    ran = registered.promote(SAME, *ANY_TIME, "--json")
    found = json.loads(ran.out)
    assert ran.code == 0 and found["outcome"] == "promoted" and not found["faults"]
    assert all(row["candidate"] == row["champion"] for row in found["table"])
    assert {row["figure"] for row in found["table"]} == {"F1", "AP", SEEN, FALSE_STATUS}
    ran = registered.promote(SAME)
    assert ran.code == 2 and f"{SAME} is tiny-lbp@champion already" in ran.err


def test_dives_of_its_own_decide_where_mission_names_them(registered, tiny_dive, tmp_path):
    registered.promote(GOOD)

    def promoted(candidate, place, last):
        labels = tiny_dive(place / "later", range(100, last))
        on = ("--mission", labels.parent, "--labels", labels, *ANY_TIME, "--json")
        return json.loads(registered.promote(candidate, *on).out)

    found = promoted(BAD, tmp_path / "long", 180)
    assert found["outcome"] == "refused" and found["faults"][0].startswith("worse on dive later")
    found = promoted(SAME, tmp_path / "short", 139)
    assert found["mode"] == "mission" and found["table"][0]["dive"] == "later"
    # Two blocks show nothing, and what shows nothing lets nothing through.
    assert found["table"][0]["remark"] == "2 blocks are too few to tell"
    (fault,) = found["faults"]
    assert found["outcome"] == "refused" and fault.startswith("too few blocks to tell anything")


def test_what_cannot_be_promoted_is_one_line(registered):
    for words, arguments in {
        "--max-ms is a time above 0": (GOOD, "--max-ms", "nan"),
        "--force needs the reason": (GOOD, "--force", " "),
        "'v2' cannot be an alias": (GOOD, "--to", "v2"),
        "no model 'x'": ("x",),
    }.items():
        ran = registered.promote(*arguments)
        assert (ran.code, ran.out) == (2, "") and words in ran.err.splitlines()[-1]
    registered.promote(GOOD)
    ran = registered.promote(SAME, "--labels", "x.csv")
    assert ran.code == 2 and "go with --mission" in ran.err
    assert registered.registry.find("tiny-lbp@champion").label == GOOD


def test_alias_says_that_champion_was_not_compared(registered):
    words = ("models", "alias", GOOD)
    ran = call_tokt(*words, "champion", "--workspace", registered.path)
    assert ran.code == 0 and "note: no comparison was made" in ran.err
    assert "note" not in call_tokt(*words, "trial", "--workspace", registered.path).err


# Of tokt 0.2: how a promotion is kept.
FORMAT_1 = (
    '{"against":"tiny-lbp/1","alias":"champion","faults":"worse on a: F1","format_version":1,'
    '"outcome":"forced","time":"2026-01-02T03:04:05+00:00","what":"dataset tiny@00","who":"eva",'
    '"why":"other camera"}'
)


def test_a_record_of_format_1_is_shown_and_a_damaged_one_is_said(registered, done):
    set_tag = registered.registry.client.set_model_version_tag
    set_tag("tiny-lbp", "2", "tokt.promotion.1767323045000000000", FORMAT_1)
    shown = done("models", "show", BAD, "--workspace", registered.path).out
    assert shown.endswith(
        "promotion 2026-01-02T03:04:05+00:00 by eva: outcome forced; alias champion; against "
        "tiny-lbp/1; what dataset tiny@00; faults worse on a: F1; why other camera\n"
    )
    for text in (FORMAT_1.replace('"format_version":1', '"format_version":2'), "[1]", "{", "{}"):
        set_tag("tiny-lbp", "2", "tokt.promotion.1767323045000000000", text)
        refuses("is damaged, or a newer", lambda: registered.registry.find(BAD).promotions)


@pytest.fixture
def judged(three):
    """Two models that judge alike, on two dives: the tiny mission's halves."""
    compared = read_held_out([SAME, GOOD], three)
    table = compared.series.table
    half = np.where(table.frame > 19, "b", "a")
    series = FrameSeries.of(table.assign(mission=half))
    dive = np.where(compared.patches.frame > 19, "b", "a")
    return replace(compared, patches=compared.patches.assign(mission=dive), series=series)


def blinded(compared, dive):
    """The candidate sees nothing on one dive."""
    candidate, champion = compared.models
    patch = (compared.patches.mission == dive).to_numpy()
    frame = (compared.series.table.mission == dive).to_numpy()[:, None]
    blind = replace(
        candidate,
        score=np.where(patch, candidate.score - 1e3, candidate.score),
        on_grid=np.where(frame, candidate.on_grid - 1e3, candidate.on_grid),
    )
    return replace(compared, models=[blind, champion])


def test_worse_on_one_dive_is_a_fault_whatever_the_other_shows(judged):
    assert judge_candidate(judged, 60_000)["faults"] == []
    found = judge_candidate(blinded(judged, "b"), 60_000)
    worse = {(row["dive"], row["figure"]) for row in found["table"] if row["worse"]}
    assert worse == {("b", "F1"), ("b", SEEN)}
    assert [words.partition(": ")[0] for words in found["faults"]] == [
        *["worse on dive b"] * 2,
        *["old dives lose too much"] * 2,  # dive b, and the mean
    ]
    # Two dives cannot show a difference over dives.
    both = next(row for row in found["table"] if not row["dive"])
    assert both["candidate"] < both["champion"] and not both["worse"]
    assert both["remark"] == "2 dives are too few to tell"


def test_false_statuses_beyond_the_rate_are_a_fault(judged):
    candidate, champion = judged.models
    ocean = np.flatnonzero(judged.series.kind("ocean"))

    def alarms(frames):
        on_grid = candidate.on_grid.copy()
        on_grid[frames] += 1e3
        return judge_candidate(
            replace(judged, models=[replace(candidate, on_grid=on_grid), champion]), 60_000
        )

    found = alarms(ocean)
    rows = [row for row in found["table"] if row["figure"] == FALSE_STATUS]
    assert [(row["dive"], row["worse"]) for row in rows] == [("a", False), ("b", False), ("", True)]
    assert all(row["candidate"] == 1 and not row["champion"] for row in rows)
    assert all("none by the champion" in row["remark"] for row in rows)
    (fault,) = found["faults"]
    assert fault.startswith("worse on all together: false status") and "of blocks; chosen" in fault
    # All blocks are what a rate of 1 in 4 frames may come to, in blocks of 4.
    bundle = candidate.bundle
    point = bundle.operating_point
    point = replace(point, chosen={**point.chosen, "target_rate": 0.25})
    candidate = replace(candidate, bundle=replace(bundle, operating_point=point))
    assert alarms(ocean)["faults"] == []


def test_a_status_that_a_rule_holds_on_to_is_no_false_one(judged):
    kind = ["ocean", "obstacle", "ocean", "ocean", "ocean", "neither", "ocean", "ocean"]
    table = judged.series.table.iloc[:8].assign(
        kind=kind, position=[1, 2, 3, 4, 5, 6, 7, 7], camera=["left"] * 7 + ["right"], mission="a"
    )
    series = FrameSeries.of(table, step=1)
    for window, apart in {1: [0, 2, 3, 4, 6, 7], 3: [0, 4, 6, 7], 9: [0, 7]}.items():
        assert np.flatnonzero(series.ocean_apart(window)).tolist() == apart
    # A missing frame counts among those of the window.
    series = FrameSeries.of(table.assign(position=[1, 2, 5, 6, 7, 8, 9, 9]), step=1)
    assert np.flatnonzero(series.ocean_apart(3)).tolist() == [0, 2, 3, 4, 6, 7]


def test_training_says_what_the_dives_of_the_version_before_lose(registered, done, told):
    registered.registry.set_alias(GOOD, "champion")
    train = ("train", "tiny", "--extractor", "lbp", "--name", "tiny-lbp", "--folds", 3)
    train += ("--embargo", 1, "--workspace", registered.path)
    said = done(*train, "--preset", "thesis").out
    assert f"WORSE than {GOOD} on its dives: tiny F1 " in said
    again = told(*train, "--preset", "plain")
    assert again["old_dives"] == {"before": GOOD, "worse": []}
