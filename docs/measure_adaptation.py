"""Measure what a model gains where it is adapted with a few frames of a new dive.

``python docs/measure_adaptation.py MODEL MISSION LABELS.csv COUNTS [WORKSPACE]``

MODEL is a registered model that never saw the dive, or ``waters``; COUNTS are numbers of labelled
frames, such as ``1,3,5,10``. Frames are drawn in one order, whose first so many are labelled. Both
versions are scored on the dive's other frames, through `tokt evaluate`. It prints one line of JSON
for each number, as `make_waters_page.py` reads them; what `tokt adapt` refuses leaves the model.
"""

import csv
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

SEED = 7


def main(model: str, mission: str, labels: str, counts: str, workspace: str | None = None) -> None:
    """Print a line for each number of frames that leaves some to score on."""
    with Path(labels).open(newline="", encoding="utf-8") as opened:
        head, *rows = csv.reader(opened)
    frame = head.index("frame")
    order = np.random.default_rng(SEED).permutation(sorted({int(row[frame]) for row in rows}))
    for count in map(int, counts.split(",")):
        if count >= len(order):
            continue
        with tempfile.TemporaryDirectory() as folder:
            learnt, others = Path(folder) / "learnt.csv", Path(folder) / "others.csv"
            chosen = set(order[:count].tolist())
            _write(learnt, head, [row for row in rows if int(row[frame]) in chosen])
            _write(others, head, [row for row in rows if int(row[frame]) not in chosen])
            where = Path(folder) / ".tokt"
            if workspace is not None:
                shutil.copytree(workspace, where)
            print(json.dumps(_row(model, mission, count, learnt, others, where)), flush=True)


def _row(
    model: str, mission: str, count: int, learnt: Path, others: Path, workspace: Path
) -> dict[str, Any]:
    told = _told("adapt", model, mission, learnt, workspace, "--draws", "1")
    adapted, before = told["adaptation"], _figures(model, mission, others, workspace)
    after = before
    if "model" in told:
        name = told["model"]
        after = _figures(f"{name['name']}/{name['version']}", mission, others, workspace)
    changes = {
        dive: one["change"] for dive, one in adapted["lost"].items() if one["change"] is not None
    }
    if "model" not in told:
        changes = {"refused": 0.0}
    worst = min(changes, key=lambda dive: changes[dive])
    return {
        **{"mission": adapted["mission"], "labelled": count, "before": before, "after": after},
        "times": adapted["times"] if "model" in told else 0,
        **{"mean": float(np.mean(list(changes.values()))), "worst": changes[worst]},
        "worst_dive": worst,
    }


def _figures(model: str, mission: str, labels: Path, workspace: Path) -> list[float | None]:
    patch = _told("evaluate", model, mission, labels, workspace)["patch"]
    return [patch["f1"], patch["average_precision"]]


def _told(
    command: str, model: str, mission: str, labels: Path, workspace: Path, *more: str
) -> dict[str, Any]:
    """Run a command of tokt's; exit code 2 with an answer is a refusal, and no fault."""
    asked = [command, model, "--mission", mission, "--labels", str(labels), *more]
    asked += ["--workspace", str(workspace), "--json"]
    ran = subprocess.run(
        [sys.executable, "-m", "tokt", *asked], capture_output=True, text=True, check=False
    )
    if not ran.stdout:
        sys.exit(ran.stderr)
    answer: dict[str, Any] = json.loads(ran.stdout)
    return answer


def _write(file: Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with file.open("w", newline="", encoding="utf-8") as opened:
        csv.writer(opened).writerows([head, *rows])


if __name__ == "__main__":
    main(*sys.argv[1:])
