"""A sample of changed inputs through the real command: ``python -m tests.fuzz.command_line``.

Each is a process of its own, as a person would start it: exit code 2 with exactly one line that
begins with ``tokt: error:``, or success; never a traceback, and nothing written beside.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random

import cv2

from .bundle_seeds import small_bundles, textured
from .case import LONGEST_LINE, Files, randomness, write_files
from .kinds import KINDS
from .label_kinds import _written as label_file

_LIMIT_S = 60.0
_PROGRAM = "from tokt.cli import main; main()"
_RUN = ("run", "--source", "dive")

Command = Callable[[str], tuple[str, ...]]
"""Given the input's first file, below the working folder, the command's arguments."""

COMMANDS: dict[str, tuple[tuple[str, ...], Command]] = {
    "deploy": (
        ("bundle.zip", "bundle.fields", "bundle.arrays", "bundle.words", "bundle.golden"),
        lambda file: ("deploy", file, "made/store", "--reason", "fuzz"),
    ),
    "run --bundle": (
        ("bundle.bytes", "bundle.manifest", "bundle.fields", "bundle.spec", "bundle.words"),
        lambda file: (*_RUN, "--bundle", file, "--policy", "texture", "--log", "made/run.jsonl"),
    ),
    "run --store": (("store",), lambda file: (*_RUN, "--store", "store", "--policy", "texture")),
    "store": (("store",), lambda file: ("store", "store", "--json")),
    "rollback": (("store",), lambda file: ("rollback", "store")),
    "labels import": (
        ("labels.csv", "labels.viame", "labels.coco", "labels.labelstudio", "labels.patches"),
        lambda file: (
            *("labels", "import", file.split("/")[0], "--mission-dir", "dive"),
            *("--workspace", "made/ws"),
        ),
    ),
    "labels import --taxonomy": (
        ("taxonomy.toml",),
        lambda file: (
            *("labels", "import", "sound/labels.csv", "--taxonomy", file),
            *("--workspace", "made/ws"),
        ),
    ),
    "calibrate --check": (
        ("calibration.opencv", "calibration.bouguet", "calibration.printed", "calibration.mat"),
        lambda file: ("calibrate", "dive", "--check", "--calibration", file),
    ),
    "run --calibration": (
        ("calibration.opencv", "calibration.bouguet", "calibration.printed"),
        lambda file: (*_RUN, "--policy", "disparity", "--calibration", file),
    ),
    "replay": (
        ("run log", "recording"),
        lambda file: (
            "replay",
            file.split("/")[0].replace(".events", ""),
            "--bundle",
            "sound.tokt",
        ),
    ),
    "shadow": (("shadow log",), lambda file: ("shadow", file, "--json")),
}


def _world(folder: Path) -> None:
    """A mission of two pairs, a sound bundle and a sound label file."""
    for side in ("Left", "Right"):
        (folder / "dive" / side).mkdir(parents=True)
        for frame in (3, 7):
            file = folder / "dive" / side / f"dive_{side[0]}_{frame}.png"
            cv2.imwrite(str(file), textured(48, 64, frame))
    (folder / "sound.tokt").write_bytes(small_bundles()[0])
    ((_, data),) = label_file("csv").items()
    write_files({"sound/labels.csv": data}, folder)


def fault_of(code: int, out: str, err: str) -> str:
    """What is wrong with how a command ended, or an empty string."""
    if "Traceback" in out + err:
        return "a traceback"
    lines = err.splitlines()
    said = [line for line in lines if line.startswith("tokt: error:")]
    if code == 2:
        if len(said) != 1:
            return f"{len(said)} lines of error"
        return "" if len(said[0]) <= LONGEST_LINE else "a line too long to read"
    if said:
        return f"exit code {code} with an error"
    return "" if code in (0, 1) else f"exit code {code}"


def _tree(folder: Path, but: set[str]) -> dict[str, tuple[int, int]]:
    """Every file with its size and time, but for those the command may write."""
    return {
        str(path.relative_to(folder)): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file() and path.relative_to(folder).parts[1:2] != ()
        if path.relative_to(folder).parts[1] not in but
    }


def _try(
    box: Path, files: Files, arguments: tuple[str, ...], port: int
) -> tuple[int, str, str, str]:
    """Run a command in a box of its own: exit code, both outputs and what is wrong."""
    cwd = box / "cwd"
    for folder in (cwd / "made", box / "home", box / "tmp"):
        folder.mkdir(parents=True)
    _world(cwd)
    write_files(files, cwd)
    if arguments[0] == "run":
        arguments = (*arguments, "--udp", f"127.0.0.1:{port}")
    # What the command is there to write; the store it may lock and mend.
    before = _tree(box, {"made", "store"})
    environment = {**os.environ, "HOME": str(box / "home"), "TMPDIR": str(box / "tmp")}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        ran = subprocess.run(
            [sys.executable, "-c", _PROGRAM, *arguments],
            cwd=cwd,
            env=environment,
            capture_output=True,
            text=True,
            errors="backslashreplace",
            timeout=_LIMIT_S,
        )
    except subprocess.TimeoutExpired:
        return -1, "", "", f"over {_LIMIT_S:g} s"
    fault = fault_of(ran.returncode, ran.stdout, ran.stderr)
    if not fault and _tree(box, {"made", "store"}) != before:
        fault = "files outside"
    return ran.returncode, ran.stdout, ran.stderr, fault


def main(arguments: list[str] | None = None) -> int:
    """Run the sample; 1 where something is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.command_line", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=330)
    parser.add_argument("--case", type=int, help="only this one, with what it prints")
    asked = parser.parse_args(arguments)
    ends: dict[str, Counter[str]] = {name: Counter() for name in COMMANDS}
    began = time.monotonic()
    numbers = range(asked.cases) if asked.case is None else [asked.case]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        for number in numbers:
            name = list(COMMANDS)[number % len(COMMANDS)]
            kinds, command = COMMANDS[name]
            rng = Random(f"command/{asked.seed}/{number}")
            kind = KINDS[rng.choice(kinds)]
            files = kind.make(randomness(asked.seed, kind.name, 10_000_000 + number))
            given = command(sorted(files, reverse=True)[0])
            with tempfile.TemporaryDirectory(prefix="tokt-fuzz-") as box:
                code, out, err, fault = _try(Path(box), files, given, receiver.getsockname()[1])
            ends[name][fault or ("refused" if code == 2 else "done")] += 1
            if fault or asked.case is not None:
                print(f"case {number} ({kind.name}): tokt {' '.join(given)}: {fault or code}")
                print(f"{out[-2000:]}\n{err[-4000:]}", flush=True)
    for name, found in ends.items():
        print(f"{name:26}", ", ".join(f"{n} {end}" for end, n in sorted(found.items())))
    print(f"seed {asked.seed}, {len(numbers)} commands, {time.monotonic() - began:.0f} s")
    bad = [end for found in ends.values() for end in found if end not in ("done", "refused")]
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main())
