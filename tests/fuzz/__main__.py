"""Run changed inputs through everything that reads files: ``python -m tests.fuzz``.

Each case follows from the seed, its kind and its number alone, so that any one can be run again:
``python -m tests.fuzz --kind bundle.zip --seed 1 --case 4711``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from .case import GOOD, End, Kind, Outcome, randomness, run_case, write_files
from .fleet import Fleet, Row
from .kinds import KINDS
from .sandbox import Sandbox

_TABLE = "tests.fuzz.kinds"
_MOST_KEPT = 20
"""Inputs of one kind that are kept."""


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bundles", type=int, default=100_000, help="changed bundles")
    parser.add_argument("--files", type=int, default=100_000, help="calibrations, labels, settings")
    parser.add_argument("--stores", type=int, default=5_000, help="changed deploy stores")
    parser.add_argument("--more", type=int, default=100_000, help="datagrams, logs, pictures")
    parser.add_argument("--kind", action="append", choices=sorted(KINDS), help="only this one")
    parser.add_argument("--case", type=int, help="only this number of --kind, in this process")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--limit-s", type=float, default=20.0, help="of one case, on the clock")
    parser.add_argument("--keep", type=Path, default=Path("build/fuzz"), help="failing inputs")
    parser.add_argument("--json", action="store_true", help="the table as JSON on standard output")
    return parser.parse_args(arguments)


def counts(kinds: Mapping[str, Kind], of_group: Mapping[str, int]) -> dict[str, int]:
    """How many cases of each kind: together at least what is asked of the group.

    A kind that takes long has no more than its most; the others share the rest.
    """
    found: dict[str, int] = {}
    for group, total in of_group.items():
        mine = [kind for kind in kinds.values() if kind.group == group]
        slow = [kind for kind in mine if kind.most < total]
        found |= {kind.name: min(kind.most, total // 10) for kind in slow}
        left = total - sum(found[kind.name] for kind in slow)
        quick = [kind for kind in mine if kind not in slow]
        shares = sum(kind.share for kind in quick)
        found |= {kind.name: -int(-left * kind.share // shares) for kind in quick}
    return found


class Keeper:
    """Keeps failing inputs, with the words and the command to run each again."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._seed = folder, seed
        self._kept: Counter[str] = Counter()

    def told(self, name: str, number: int, outcome: Outcome) -> None:
        """Keep one; more than enough of a kind are only counted."""
        self._kept[name] += 1
        if self._kept[name] > _MOST_KEPT:
            return
        folder = self._folder / f"{name.replace(' ', '_')}-{self._seed}-{number}"
        write_files(KINDS[name].make(randomness(self._seed, name, number)), folder / "input")
        command = f"python -m tests.fuzz --kind '{name}' --seed {self._seed} --case {number}"
        words = f"{outcome.end}\n{outcome.words}\n\n{command}\n"
        (folder / "failure.txt").write_text(words, "utf-8", "backslashreplace")
        last = outcome.words.strip().splitlines()[-1:] or [""]
        print(f"{outcome.end}: {last[0][:200]}\n  {command}", file=sys.stderr, flush=True)


_BAD = [end for end in End if end not in GOOD]


def table(rows: list[Row]) -> str:
    """The table for people."""
    head = ["kind", "cases", *map(str, End), "slowest ms", "memory MB"]
    lines = [[*_cells(row.kind, row.ends), *_costs(row)] for row in rows if row.ends.total()]
    every = sum((row.ends for row in rows), Counter[str]())
    lines.append([*_cells("all", every), "", ""])
    widths = [max(map(len, column)) for column in zip(head, *lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if place else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(line, widths, strict=True))
        )
        for line in [head, *lines]
    )


def _cells(name: str, ends: Counter[str]) -> list[str]:
    return [name, str(ends.total()), *(str(ends[end]) for end in End)]


def _costs(row: Row) -> list[str]:
    return [f"{row.slowest_s * 1000:.0f}", f"{row.memory_mb:.0f}"]


def _one(name: str, seed: int, number: int) -> int:
    kind = KINDS[name]
    files = kind.make(randomness(seed, name, number))
    print({path: len(data) for path, data in files.items()}, flush=True)
    with tempfile.TemporaryDirectory() as box:
        outcome = run_case(kind, files, Sandbox(Path(box)))
    print(f"{outcome.end} in {outcome.seconds * 1000:.1f} ms\n{outcome.words}")
    return int(outcome.end not in GOOD)


def main(arguments: list[str] | None = None) -> int:
    """Run what is asked for; 1 where something failed."""
    # Threads of a library would hide what one case costs, and be lost memory under the limit.
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    asked = _options(arguments)
    if asked.case is not None:
        if not asked.kind:
            sys.exit("--case needs --kind")
        return _one(asked.kind[0], asked.seed, asked.case)
    groups = {name: getattr(asked, name) for name in ("bundles", "files", "stores", "more")}
    wanted = counts(KINDS, groups)
    if asked.kind:
        wanted = {name: wanted[name] for name in asked.kind}
    began = time.monotonic()
    keeper = Keeper(asked.keep, asked.seed)
    fleet = Fleet(_TABLE, asked.seed, asked.workers, asked.limit_s, keeper.told)
    try:
        fleet.run(wanted)
    finally:  # what was done until somebody interrupts, too
        rows = list(fleet.rows.values())
        print(table(rows), file=sys.stderr if asked.json else sys.stdout)
    minutes = (time.monotonic() - began) / 60
    print(f"seed {asked.seed}, {minutes:.1f} min, {asked.workers} processes", file=sys.stderr)
    if asked.json:
        print(json.dumps({"seed": asked.seed, "minutes": minutes, "kinds": _json(rows)}, indent=1))
    return int(any(row.ends[end] for row in rows for end in _BAD))


def _json(rows: list[Row]) -> dict[str, dict[str, float]]:
    return {
        row.kind: {
            "cases": row.ends.total(),
            **{str(end): row.ends[end] for end in End},
            "slowest_ms": round(row.slowest_s * 1000, 1),
            "slowest_case": row.slowest_case,
            "memory_mb": round(row.memory_mb, 1),
        }
        for row in rows
    }


if __name__ == "__main__":
    sys.exit(main())
