"""How many cases there are of each kind, the box they are read in, and the table of a long run."""

import os
import tempfile
import time
from collections.abc import Callable
from random import Random

import hypothesis
import pandas as pd
import pytest
from hypothesis import HealthCheck, Phase, given
from hypothesis import strategies as st

from . import bundles, labels, runs, settings, stores
from .case import Box, Kind, limited_memory, peak_mb

KINDS: dict[str, Kind] = {
    kind.name: kind for module in (bundles, labels, runs, settings, stores) for kind in module.KINDS
}
CASES = int(os.environ.get("TOKT_FUZZ_EXAMPLES", "0"))
"""Cases of bundles, of files and of all else, each; 0 for a few of every kind, always the same."""
_RANDOMS = st.sampled_from((False, True, True, True)).flatmap(
    lambda seeded: st.randoms(use_true_random=seeded)
)
"""Choices of hypothesis, which it can make smaller; seeds for the most part, for they repeat less:
1500 cases of labels.csv are refused with 490 different messages by seeds, with 270 by choices."""
_HEAD = ("cases", "refused", "slowest ms", "memory MB")


@pytest.fixture
def box(tmp_path, monkeypatch, capfd):
    with capfd.disabled():
        terminal = os.dup(2)
    box = Box(tmp_path, terminal)
    monkeypatch.chdir(box.case.parent)
    monkeypatch.setenv("HOME", str(box.box / "home"))
    monkeypatch.setenv("TMPDIR", str(box.box / "tmp"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    with limited_memory():
        yield box
    os.close(terminal)


@pytest.fixture
def try_cases(record_property):
    """Have hypothesis try cases: at least a few, and `share` percent of `CASES`.

    `check` is given the random numbers; it says why the case was refused, or nothing.
    """

    def run(check: Callable[[Random], str], few: int, share: float, *phases: Phase) -> None:
        refusals: list[bool] = []
        slowest_s, before = 0.0, peak_mb(reset=True)
        if not (count := max(few, round(CASES * share / 100))):
            pytest.skip("only with many cases (`make fuzz`): each is a process")

        @hypothesis.settings(
            max_examples=count,
            derandomize=not CASES,
            database=None,
            deadline=None,
            phases=(Phase.generate, *phases),
            report_multiple_bugs=False,
            suppress_health_check=list(HealthCheck),
        )
        @given(_RANDOMS)
        def each(rng: Random) -> None:
            nonlocal slowest_s
            began = time.process_time()
            refusals.append(bool(check(rng)))
            slowest_s = max(slowest_s, time.process_time() - began)

        each()
        row = (len(refusals), sum(refusals), slowest_s * 1000, peak_mb() - before)
        record_property("fuzz", list(map(round, row)))

    return run


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show what came of each kind, where many cases were asked for."""
    if not CASES:
        return
    terminalreporter.section("fuzz")
    rows = {
        report.nodeid.partition("[")[2].removesuffix("]"): dict(report.user_properties)["fuzz"]
        for report in terminalreporter.getreports("passed")
        if report.when == "call" and "fuzz" in dict(report.user_properties)
    }
    table = pd.DataFrame.from_dict(rows, "index", columns=list(_HEAD))
    terminalreporter.line(table.to_string())
