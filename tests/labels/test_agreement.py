from dataclasses import asdict, replace
from pathlib import Path

import pytest

from tests.calls import refuses, run_python
from tokt.features.frames.grid import Grid
from tokt.labels.agreement import agreement
from tokt.labels.formats.label_csv import read_label_csv
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import Taxonomy

TAXONOMY = Taxonomy.load()
TIME = "2016-04-20T10:00:00Z"
ROOT = Path(__file__).parents[2]
SHORT = {"o": "ocean", "r": "reef", "s": "sand", "?": "unsure"}


def _labels(text, annotator):
    return [
        LabelRecord("dive", "left", n, Grid(), 0, 0, SHORT[sign], annotator, TIME)
        for n, sign in enumerate(text)
        if sign != " "
    ]


def _compare(a, b):
    return agreement(_labels(a, "a"), _labels(b, "b"), TAXONOMY)


def test_figures_by_hand():
    #                  sure: 5 oo, 1 or, 1 ro, 3 rr; with unsure of one, of the other, of both
    found = _compare("oooooorrrrr?? o", "ooooororrr?o?o ")
    assert (found.n_a, found.n_b, found.n_both, found.n_both_sure) == (14, 14, 13, 10)
    # po = 8/10, pe = (6*6 + 4*4)/100
    assert found.kappa == pytest.approx((0.8 - 0.52) / (1 - 0.52))
    assert found.agreement == pytest.approx(0.8)
    assert found.agreement_with_unsure == pytest.approx(9 / 13)
    assert found.labels == ["ocean", "reef", "unsure"]
    assert found.confusion == [[5, 1, 0], [1, 3, 1], [1, 0, 1]]
    # pe over 13: a 6,5,2; b 7,4,2
    chance = (6 * 7 + 5 * 4 + 2 * 2) / 169
    assert found.kappa_with_unsure == pytest.approx((9 / 13 - chance) / (1 - chance))
    reef = found.per_class["reef"]
    assert (reef.n_a, reef.n_b, reef.n_both) == (5, 4, 3)
    assert (reef.precision, reef.recall) == (3 / 4, 3 / 5)
    assert reef.f1 == pytest.approx(6 / 9)
    # A sure on 11: obstacles of A 5, of B 4 (its unsure counts as none), both 3
    obstacle = found.obstacle
    assert (obstacle.n_a, obstacle.n_b, obstacle.n_both) == (5, 4, 3)


def test_two_kinds_of_obstacle_agree_on_being_one():
    found = _compare("rso", "sro")
    assert found.obstacle.f1 == 1.0
    assert found.per_class["reef"].f1 == 0.0


def test_kappa_is_undefined_on_a_single_class():
    found = _compare("ooo?", "ooo?")
    assert found.kappa is None and found.agreement == 1.0
    assert found.kappa_with_unsure == 1.0
    assert found.obstacle.f1 is None and found.obstacle.precision is None
    nobody_sure = _compare("??", "??")
    assert nobody_sure.agreement is None and nobody_sure.kappa_with_unsure is None


def test_opposite_single_classes_are_no_agreement():
    assert _compare("ooo", "rrr").kappa == 0.0


def test_a_class_that_left_the_taxonomy():
    first, second = _labels("oorr?", "a"), _labels("orrr?", "b")
    kelp = [replace(said, label="kelp") if said.label == "reef" else said for said in second]
    found = agreement(first, kelp, TAXONOMY)
    assert found.labels == ["ocean", "reef", "kelp", "unsure"] and found.unknown == ["kelp"]
    assert found.confusion == [[1, 0, 1, 0], [0, 0, 2, 0], [0, 0, 0, 0], [0, 0, 0, 1]]
    assert found.obstacle is None and asdict(found)["obstacle"] is None
    # po 1/4; pe (2*1)/16, ocean being all that both have
    assert found.kappa == pytest.approx((1 / 4 - 1 / 8) / (1 - 1 / 8))
    assert found.per_class["kelp"].n_b == 3
    known = agreement(first, second, TAXONOMY)
    assert known.unknown == [] and known.obstacle is not None


def test_the_command_line_says_which_class_is_missing(run_tokt, tmp_path):
    with LabelStore(tmp_path / "labels.db") as store:
        kelp = [replace(said, label="kelp") for said in _labels("oo", "b")]
        store.add([*_labels("or", "a"), *kelp])
    ran = run_tokt("labels", "agreement", "a", "b", "--workspace", tmp_path)
    assert ran.code == 0
    line = next(line for line in ran.out.splitlines() if line.startswith("obstacle (A sure"))
    assert line.split()[-6:] == ["-"] * 6
    note = f"note: class 'kelp' is not in the taxonomy: add it to {tmp_path / 'taxonomy.toml'}\n"
    assert ran.err == note
    file = tmp_path / "own.toml"
    file.write_text((ROOT / "labels" / "taxonomy.toml").read_text().replace('"ocean"', '"kelp"', 1))
    ran = run_tokt("labels", "agreement", "a", "b", "--workspace", tmp_path, "--taxonomy", file)
    assert ran.err == f"note: class 'ocean' is not in the taxonomy: add it to {file}\n"


def test_suggestions_are_left_out():
    suggestion = LabelRecord("dive", "left", 0, Grid(), 0, 0, "reef", "a", TIME, "model", "lbp/1")
    assert agreement([suggestion, *_labels("o", "a")], _labels("o", "b"), TAXONOMY).n_a == 1


def test_what_cannot_be_compared():
    refuses("no patch is labelled by both", _compare, "oo  ", "  oo")
    two = _labels("o", "a") + _labels("o", "c")
    refuses("labelled by a and by c", agreement, two, _labels("o", "b"), TAXONOMY)


def test_without_scikit_learn_the_remedy_is_named():
    code = """
import sys
sys.modules["sklearn"] = None
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.labels.agreement import agreement
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy
said = [LabelRecord("d", "left", 1, Grid(), 0, 0, "reef", "a", "2016-04-20T10:00:00Z")]
try:
    agreement(said, said, Taxonomy.load())
except ToktError as error:
    print(error)
"""
    ran = run_python("-c", code)
    assert ran.returncode == 0 and "extra 'label'" in ran.stdout


@pytest.mark.mission
def test_the_two_annotators_of_the_mission(mission_dir):
    """Kappa 1.0 where both are sure; F1 0.986 with labels.csv as A, the reference."""
    files = (mission_dir / "labels.csv", mission_dir / "labels_second_annotator.csv")
    a, b = (read_label_csv(path, TAXONOMY) for path in files)
    found = agreement(a, b, TAXONOMY)
    assert found.n_both == 2000
    assert found.kappa == 1.0
    assert round(found.obstacle.f1, 3) == 0.986
    assert round(agreement(b, a, TAXONOMY).obstacle.f1, 3) == 0.982
