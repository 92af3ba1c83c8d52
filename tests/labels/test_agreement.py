from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tokt.features.errors import ToktError
from tokt.features.grid import Grid
from tokt.labels.agreement import Agreement, agreement
from tokt.labels.label_csv import read_label_csv
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy

TAXONOMY = Taxonomy.load()
TIME = "2016-04-20T10:00:00Z"
ROOT = Path(__file__).parents[2]
MISSION = Path(os.environ.get("TOKT_MISSION", ROOT / "../shared/mission/approach"))
SHORT = {"o": "ocean", "r": "reef", "s": "sand", "?": "unsure"}


def _labels(text: str, annotator: str) -> list[LabelRecord]:
    return [
        LabelRecord("dive", "left", n, Grid(), 0, 0, SHORT[sign], annotator, TIME)
        for n, sign in enumerate(text)
        if sign != " "
    ]


def _compare(a: str, b: str) -> Agreement:
    return agreement(_labels(a, "a"), _labels(b, "b"), TAXONOMY)


def test_figures_by_hand() -> None:
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
    assert (found.obstacle.n_a, found.obstacle.n_b, found.obstacle.n_both) == (5, 4, 3)


def test_two_kinds_of_obstacle_agree_on_being_one() -> None:
    found = _compare("rso", "sro")
    assert found.obstacle.f1 == 1.0
    assert found.per_class["reef"].f1 == 0.0


def test_kappa_is_undefined_on_a_single_class() -> None:
    found = _compare("ooo?", "ooo?")
    assert found.kappa is None and found.agreement == 1.0
    assert found.kappa_with_unsure == 1.0
    assert found.obstacle.f1 is None and found.obstacle.precision is None
    nobody_sure = _compare("??", "??")
    assert nobody_sure.agreement is None and nobody_sure.kappa_with_unsure is None


def test_opposite_single_classes_are_no_agreement() -> None:
    assert _compare("ooo", "rrr").kappa == 0.0


def test_suggestions_are_left_out() -> None:
    suggestion = LabelRecord("dive", "left", 0, Grid(), 0, 0, "reef", "a", TIME, "model", "lbp/1")
    assert agreement([suggestion, *_labels("o", "a")], _labels("o", "b"), TAXONOMY).n_a == 1


def test_what_cannot_be_compared() -> None:
    with pytest.raises(ToktError, match="no patch is labelled by both"):
        _compare("oo  ", "  oo")
    with pytest.raises(ToktError, match="labelled by a and by c"):
        agreement(_labels("o", "a") + _labels("o", "c"), _labels("o", "b"), TAXONOMY)


def test_without_scikit_learn_the_remedy_is_named() -> None:
    code = """
import sys
sys.modules["sklearn"] = None
from tokt.features.errors import ToktError
from tokt.features.grid import Grid
from tokt.labels.agreement import agreement
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy
said = [LabelRecord("d", "left", 1, Grid(), 0, 0, "reef", "a", "2016-04-20T10:00:00Z")]
try:
    agreement(said, said, Taxonomy.load())
except ToktError as error:
    print(error)
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "tokt[train]" in ran.stdout


@pytest.mark.mission
def test_the_two_annotators_of_the_mission() -> None:
    """Kappa 1.0 where both are sure; F1 0.986 with labels.csv as A, the reference."""
    first, second = MISSION / "labels.csv", MISSION / "labels_second_annotator.csv"
    if not (first.is_file() and second.is_file()):
        pytest.skip(f"no mission labels in {MISSION} (TOKT_MISSION)")
    a, b = (read_label_csv(path, TAXONOMY) for path in (first, second))
    found = agreement(a, b, TAXONOMY)
    assert found.n_both == 2000
    assert found.kappa == 1.0
    assert found.obstacle.f1 is not None and round(found.obstacle.f1, 3) == 0.986
    swapped = agreement(b, a, TAXONOMY)
    assert swapped.obstacle.f1 is not None and round(swapped.obstacle.f1, 3) == 0.982
