"""Results of the faults injected into a soak, by their rows: silences, and what was reported."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import attrgetter

import numpy as np

from tests.fault_rows import rows_by_fault
from tokt.features.common.arrays import Bools

from .injector import Injection
from .run import Run
from .standstill import Interval, overlap_s

_ROW = attrgetter("row")


@dataclass(frozen=True)
class FaultResult:
    """All times that one fault was injected."""

    row: str
    times: int
    longest_s: float  # silence of v2, without what the machine stood still of it
    bound_s: float
    source: str  # of the bound
    missing: tuple[str, ...]  # of what the row says

    @property
    def is_heard(self) -> bool:
        """True if no silence was longer than its bound."""
        return self.longest_s <= self.bound_s

    @property
    def words(self) -> str:
        """The row, or the beginning of a long one."""
        return self.row if len(self.row) <= _WIDTH else f"{self.row[: _WIDTH - 1]}…"


_WIDTH = 90


def fault_results(run: Run) -> list[FaultResult]:
    """Sum up what the faults came to, a result for each row, in the order of the page."""
    assert run.around is not None
    silences = _by_fault(run)
    results = []
    page = list(rows_by_fault())
    injections = sorted(run.around.injections, key=lambda each: page.index(each.row))
    for row, group in groupby(injections, _ROW):
        of_row = list(group)
        missing = dict.fromkeys(words for each in of_row for words in each.missing)
        results.append(
            FaultResult(
                row=row,
                times=len(of_row),
                longest_s=max((s for each in of_row for s in silences[each]), default=0.0),
                bound_s=of_row[0].bound_s,
                source=of_row[0].source,
                missing=tuple(missing),
            )
        )
    return results


def longest_without_fault_s(run: Run) -> float:
    """Return the longest silence while no fault lasted, in seconds."""
    return max(_by_fault(run)[None], default=0.0)


def without_fault(run: Run) -> Bools:
    """Mark the frames that were judged while no fault lasted: bool, shape (n_frames,)."""
    quiet = run.age_s > 0
    for each in () if run.around is None else run.around.injections:
        quiet &= (run.heard_s < each.from_s) | (run.heard_s > each.to_s)
    return np.asarray(quiet)


def _by_fault(run: Run) -> dict[Injection | None, list[float]]:
    """List silences in seconds, less what the machine stood still, by the fault that lasted."""
    assert run.around is not None
    lengths: dict[Injection | None, list[float]] = {each: [] for each in run.around.injections}
    lengths[None] = []
    for silence in run.silences:
        stood_s = sum(overlap_s(silence, gap) for gap in run.around.standstills)
        cause = _cause(silence, run.around.injections)
        lengths[cause].append(silence[1] - silence[0] - stood_s)
    return lengths


def _cause(silence: Interval, injections: Sequence[Injection]) -> Injection | None:
    """Return the fault that lasted in a silence: of several the one with the longest bound."""
    during = [each for each in injections if overlap_s(silence, (each.from_s, each.to_s))]
    return max(during, key=attrgetter("bound_s"), default=None)


def lines_lost_without_fault(run: Run) -> int:
    """Count lines of the log that were lost between two looks while no fault of the log lasted."""
    assert run.around is not None
    faults = [(each.from_s, each.to_s) for each in run.around.injections if "log" in each.row]
    samples = run.around.attendant.samples
    return sum(
        max(later["log_lines_lost"] - earlier["log_lines_lost"], 0)
        for earlier, later in pairwise(samples)
        if earlier["life"] == later["life"]
        and not any(overlap_s((earlier["at_s"], later["at_s"]), fault) for fault in faults)
    )
