"""The cost of a run's stages in instructions and in bytes, which do not depend on the machine.

::

    parent: render, fit ──> model, pictures ──> counted_run, under callgrind ──> parent: the table
                                                 └──> the stages between cuts ──┘

Valgrind shows a program the same processor on every x86 machine with AVX2: counted is code for
AVX2, also where there is more. The caches are simulated, of the sizes that `CACHES` says.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import open_mission
from tokt.features.kernels.dispatch import KERNELS, VARIABLE
from tokt.labels.formats.options import Progress
from tokt.training.fitting.presets import settings_named
from tokt.training.options import Notice
from tokt_studies.simulation.rendering.synthetic_mission import MissionScene, simulate_mission

from .counted_run import CUT, MODEL, PICTURES, SEGMENTS, START, WARM_UP
from .models import fit_preset_bundle, learnt_examples
from .paired_timing import single_thread

COUNTED = 6
"""Frames, 0.4 s of a camera's: points are followed in two of them, as in each 0.2 s, and fixed
marks looked for in one, as in each half second."""
_DIVE, _FIRST = 400, 240
"""Frames of the whole rendered dive, and the first one that is taken: the tower is 6 m away."""
CACHES = {"I1": "32768,8,64", "D1": "32768,8,64", "LL": "1048576,16,64"}
"""Bytes, ways and bytes of a line: a first cache as most cores have, and the last one of a
Raspberry Pi 4 (Broadcom BCM2711: 1 MB, 16 ways)."""
LINE_BYTES = 64
_MISSES = ("ILmr", "DLmr", "DLmw")
"""Callgrind's events: lines that the last cache did not have, to be executed, read and written."""
_NO_VALGRIND = "--count needs valgrind, which is not there: apt install valgrind"
_ENVIRONMENT = {
    "PYTHONHASHSEED": "0",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    VARIABLE: KERNELS.name,
}
"""Of the counted process: what would differ from run to run."""


@dataclass(frozen=True)
class StageCost:
    """The cost of one stage, without the stages that it calls; a frame's mean."""

    stage: str
    when: str  # ``before`` or ``after``: of the frame's datagram
    instructions: float
    bytes_moved: float  # between the last cache and memory, read or about to be written


@dataclass(frozen=True)
class InstructionCount:
    """Costs of all stages of a run, and what it was."""

    costs: list[StageCost]
    about: dict[str, Any]  # everything else of the JSON object

    def total(self, when: str = "") -> StageCost:
        """All stages together, or those before or after the datagram."""
        chosen = [cost for cost in self.costs if when in ("", cost.when)]
        instructions = sum(cost.instructions for cost in chosen)
        return StageCost("total", when, instructions, sum(cost.bytes_moved for cost in chosen))

    def to_json(self) -> dict[str, Any]:
        """The JSON object of ``tokt bench --count --json``."""
        totals = {when or "all": asdict(self.total(when)) for when in ("before", "after", "")}
        for total in totals.values():
            del total["stage"], total["when"]
        return {"stages": [asdict(cost) for cost in self.costs], "totals": totals, **self.about}


def run_count(out: Path, preset: str, progress: Progress, say: Notice) -> InstructionCount:
    """Count the run of a preset's model on a rendered dive, and write ``count.json`` into `out`.

    ToktError if valgrind is not there or the preset is not known.
    """
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with --out")
    settings_named(preset)  # before anything is rendered for it
    valgrind, vgdb = shutil.which("valgrind"), shutil.which("vgdb")
    if valgrind is None or vgdb is None:
        raise ToktError(_NO_VALGRIND)
    with tempfile.TemporaryDirectory(prefix="tokt-bench-") as name:
        folder = Path(name)
        say("-- render a dive")
        _prepare(preset, folder, progress)
        say("-- run it: once as it is, then under valgrind, which takes a minute or two")
        # As it is first: valgrind then finds modules compiled, and what fails does so at once.
        _run_child(folder)
        counts = folder / "callgrind.out"
        caches = [f"--{cache}={size}" for cache, size in CACHES.items()]
        parts = [f"--dump-before={CUT}", "--combine-dumps=yes", f"--callgrind-out-file={counts}"]
        kind = [valgrind, "--tool=callgrind", "--instr-atstart=no", "--cache-sim=yes"]
        _run_child(folder, vgdb, under=[*kind, *caches, *parts])
        found = json.loads((folder / SEGMENTS).read_text("utf-8"))
        segments = found.pop("segments")
        costs = stage_costs(segments, list(counted_parts(counts)))
    about = {"preset": preset, "frames": COUNTED, "caches": CACHES, **found}
    count = InstructionCount(costs, about)
    text = json.dumps(count.to_json(), indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(out / "count.json", text + "\n")
    return count


def _prepare(preset: str, folder: Path, progress: Progress) -> None:
    """Write the model and the pictures of a count."""

    def draw(seed: int, n_frames: int, width: int) -> MissionScene:
        dive = MissionScene.draw(seed, _DIVE, width)
        return replace(dive, poses=dive.poses[_FIRST : _FIRST + n_frames])

    dive = folder / "dive"
    simulate_mission(dive, n_frames=WARM_UP + COUNTED, progress=progress, draw=draw)
    mission = open_mission(dive)
    pictures = np.stack([mission.read(number) for number in mission.frames()])
    with single_thread():
        bundle = fit_preset_bundle(preset, learnt_examples(mission), pictures[0])
    (folder / MODEL).write_bytes(bundle.data)
    np.save(folder / PICTURES, pictures)


def _run_child(folder: Path, *more: str, under: Sequence[str] = ()) -> None:
    """Run the process that is counted, `under` another program if it is to be."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment = {**kept, **_ENVIRONMENT, "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
    child = [sys.executable, "-m", "tokt_studies.speed.counted_run", str(folder), *more]
    ended = subprocess.run(
        [*under, *child], env=environment, capture_output=True, text=True, errors="replace"
    )
    if ended.returncode != 0:
        last = (ended.stderr.strip().splitlines() or [""])[-1]
        raise ToktError(f"the counted run ended with {ended.returncode}: {last}")


def counted_parts(file: Path) -> Iterator[dict[str, int]]:
    """The events that callgrind counted in each part of its file; zeros at the end are left out."""
    events: list[str] = []
    with file.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if line.startswith("events:"):
                events = line.split()[1:]
            elif line.startswith("totals:"):
                counts = [int(count) for count in line.split()[1:]]
                yield dict(zip(events, counts, strict=False))


def stage_costs(
    segments: Sequence[tuple[str, bool]], parts: Sequence[Mapping[str, int]]
) -> list[StageCost]:
    """Sum up the parts by stage, in order of when a stage is first entered; a frame's mean.

    A segment is a stage, and whether the datagram was sent; the part after the last is the end.
    """
    if len(parts) != len(segments) + 1:
        raise ToktError(f"callgrind wrote {len(parts)} parts of {len(segments) + 1}")
    instructions: Counter[tuple[bool, str]] = Counter()
    lines: Counter[tuple[bool, str]] = Counter()
    for (stage, sent), part in zip(segments, parts[:-1], strict=True):
        if stage != START:
            instructions[sent, stage] += part["Ir"]
            lines[sent, stage] += sum(part.get(event, 0) for event in _MISSES)
    return [
        StageCost(
            stage,
            "after" if sent else "before",
            instructions[sent, stage] / COUNTED,
            LINE_BYTES * lines[sent, stage] / COUNTED,
        )
        for sent, stage in sorted(instructions, key=lambda key: key[0])
    ]
