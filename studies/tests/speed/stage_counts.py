"""Instructions of each stage of a run, compared with those in `stage_counts.json` beside this file.

``make count`` compares, ``make count ARGS=--write`` stores what is counted here.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tokt.features.common import atomic
from tokt.features.common.terminal import say
from tokt_studies.speed.count_report import print_counts
from tokt_studies.speed.instruction_count import run_count

STORED = Path(__file__).with_suffix(".json")
TENTH = 0.1
"""By which a stage may grow or shrink. Six runs: 0.03 for the loop, 0.005 for others."""
ANEW = "what is meant to be so is written anew: make count ARGS=--write"

Stages = Mapping[str, float]


def table(found: Mapping[str, Any]) -> dict[str, Any]:
    """What is stored of a count's JSON object: the code, and million instructions a frame."""
    stages = {
        f"{one['stage']}, {one['when']} the datagram": round(one["instructions"] / 1e6, 4)
        for one in found["stages"]
    }
    return {"preset": found["preset"], "code": found["code"], "stages": stages}


def other_code(stored: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """Words for what of the code is other than where the table was written; empty if nothing is."""
    there, here = stored["code"], found["code"]
    other = [key for key in here if there.get(key) != here[key]]
    return "; ".join(f"{key} {here[key]}, not {there.get(key)}" for key in other)


def changes(stored: Stages, found: Stages) -> list[str]:
    """A line for each stage that is new, is gone, or has grown or shrunk by more than a tenth."""
    lines = []
    for name in {**stored, **found}:
        before, now = stored.get(name), found.get(name)
        if before is None or now is None:
            lines.append(f"{name}: is {'new' if before is None else 'gone'}")
        elif not (1 - TENTH) * before <= now <= (1 + TENTH) * before:
            more = now / before - 1
            lines.append(f"{name}: {before:.2f} to {now:.2f} million instructions ({more:+.0%})")
    return lines


def main() -> int:
    """Count, then store or compare; 1 where a stage differs."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="store what is counted")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as out:
        count = run_count(Path(out), "best", lambda items, total, what: items, say)
    print_counts(count)
    found = table(count.to_json())
    if asked.write:
        atomic.write_text(STORED, json.dumps(found, indent=1) + "\n")
        return 0
    stored = json.loads(STORED.read_text("utf-8"))
    if other := other_code(stored, found):
        print(f"written with other code: {other}")
    lines = changes(stored["stages"], found["stages"])
    print("\n".join([*lines, ANEW] if lines else ["all stages are as stored, to a tenth"]))
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
