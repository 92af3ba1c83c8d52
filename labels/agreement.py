"""Agreement of two annotators on the patches that both labelled."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from tokt.features.common.errors import ToktError
from tokt.features.common.extras import needed_by

from .record import HUMAN, Cell, LabelRecord
from .taxonomy import UNSURE, Taxonomy


@dataclass(frozen=True)
class ClassAgreement:
    """Agreement on one class, with A as the reference; None where nothing is divided."""

    n_a: int  # patches that A gave this class
    n_b: int  # that B did
    n_both: int  # that both did
    precision: float | None  # n_both / n_b
    recall: float | None  # n_both / n_a
    f1: float | None  # 2 n_both / (n_a + n_b), the positive agreement; the same with A, B exchanged


@dataclass(frozen=True)
class Agreement:
    """What two annotators' labels have in common."""

    n_a: int  # patches labelled by A (``unsure`` is a label here)
    n_b: int  # by B
    n_both: int  # by both
    n_both_sure: int  # patches that both gave a class
    # Cohen's kappa and the share of equal labels, over the patches where both are sure. None where
    # there is no such patch; kappa also where all are of one class (it is undefined).
    kappa: float | None
    agreement: float | None
    # The same over all patches labelled by both, ``unsure`` being a class of its own.
    kappa_with_unsure: float | None
    agreement_with_unsure: float | None
    labels: list[str]  # the taxonomy's that occur, in its order, then `unknown`, then ``unsure``
    unknown: list[str]  # classes that occur and are not in the taxonomy (any more), by name
    confusion: list[list[int]]  # [i][j]: patches that A labelled ``labels[i]`` and B ``labels[j]``
    per_class: dict[str, ClassAgreement]  # over all patches labelled by both, by label
    # On "is an obstacle", over the patches where A is sure; B's ``unsure`` counts as no obstacle.
    # It depends on who is A. None where a class is unknown.
    obstacle: ClassAgreement | None


def agreement(
    a_records: Iterable[LabelRecord], b_records: Iterable[LabelRecord], taxonomy: Taxonomy
) -> Agreement:
    """Compare the labels of annotator A with those of annotator B.

    Model suggestions among them are left out. The taxonomy says which class is an obstacle. Kappa
    is Cohen's (A coefficient of agreement for nominal scales, Educational and Psychological
    Measurement 20, 1960); the positive agreement is that of Cicchetti and Feinstein (High agreement
    but low kappa II, Journal of Clinical Epidemiology 43, 1990).

    Raises ToktError if a patch is labelled twice on one side, no patch is labelled on both, or
    scikit-learn is not installed.
    """
    a, b = _by_cell(a_records), _by_cell(b_records)
    pairs = Counter((label, b[cell]) for cell, label in a.items() if cell in b)
    return agreement_of_counts(pairs, len(a), len(b), taxonomy)


def agreement_of_counts(
    pairs: Counter[tuple[str, str]], n_a: int, n_b: int, taxonomy: Taxonomy
) -> Agreement:
    """`agreement` from counts alone, with the same errors.

    `pairs` has how often A and B gave a patch two labels, over the patches that both labelled; they
    labelled `n_a` and `n_b` patches in all.
    """
    if not pairs:
        raise ToktError("no patch is labelled by both (same mission, camera, frame, grid, cell)")
    used = {label for pair in pairs for label in pair}
    unknown = sorted(used - {*taxonomy.names, UNSURE})
    labels = [name for name in (*taxonomy.names, *unknown, UNSURE) if name in used]
    sure = Counter({pair: n for pair, n in pairs.items() if UNSURE not in pair})
    of_sure_a = Counter({pair: n for pair, n in pairs.items() if pair[0] != UNSURE})
    obstacles = {name for name in taxonomy.names if taxonomy.is_obstacle(name)}
    return Agreement(
        n_a=n_a,
        n_b=n_b,
        n_both=pairs.total(),
        n_both_sure=sure.total(),
        kappa=_kappa(sure),
        agreement=_share_equal(sure),
        kappa_with_unsure=_kappa(pairs),
        agreement_with_unsure=_share_equal(pairs),
        labels=labels,
        unknown=unknown,
        confusion=[[pairs[of_a, of_b] for of_b in labels] for of_a in labels],
        per_class={name: _agreement_on({name}, pairs) for name in labels},
        obstacle=None if unknown else _agreement_on(obstacles, of_sure_a),
    )


def _by_cell(records: Iterable[LabelRecord]) -> dict[Cell, str]:
    found: dict[Cell, LabelRecord] = {}
    for record in records:
        if record.source != HUMAN or record.label is None:
            continue
        first = found.setdefault(record.cell, record)
        if first is not record:
            raise ToktError(
                f"{record.cell} is labelled by {first.annotator} and by {record.annotator};"
                " compare one annotator at a time"
            )
    return {cell: str(record.label) for cell, record in found.items()}


def _kappa(pairs: Counter[tuple[str, str]]) -> float | None:
    with needed_by("agreement", "label"):
        from sklearn.metrics import cohen_kappa_score
    if len({label for pair in pairs for label in pair}) < 2:
        return None
    of_a, of_b = zip(*pairs, strict=True)
    return float(cohen_kappa_score(of_a, of_b, sample_weight=list(pairs.values())))


def _share_equal(pairs: Counter[tuple[str, str]]) -> float | None:
    equal = sum(n for (of_a, of_b), n in pairs.items() if of_a == of_b)
    return equal / pairs.total() if pairs else None


def _agreement_on(names: set[str], pairs: Counter[tuple[str, str]]) -> ClassAgreement:
    """Agreement on whether a patch is of one of these classes."""
    n_a = sum(n for (of_a, _), n in pairs.items() if of_a in names)
    n_b = sum(n for (_, of_b), n in pairs.items() if of_b in names)
    n_both = sum(n for pair, n in pairs.items() if names.issuperset(pair))
    return ClassAgreement(
        n_a=n_a,
        n_b=n_b,
        n_both=n_both,
        precision=n_both / n_b if n_b else None,
        recall=n_both / n_a if n_a else None,
        f1=2 * n_both / (n_a + n_b) if n_a + n_b else None,
    )
