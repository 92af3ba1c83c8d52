"""Changed inputs through the real command: a refusal is one line and exit code 2.

Each is a process of its own, as a person would start it: exit code 2 with exactly one line that
begins with ``tokt: error:``, or success; never a traceback, and nothing written beside.
"""

import shutil
from pathlib import Path
from random import Random

import pytest

from tests.calls import run_python
from tests.inference.live import bound_socket
from tokt.labels.formats import NAMES

from .bundles import FILE, small_bundles
from .case import MAX_LINE, DefectError, Files, write_files
from .conftest import KINDS
from .labels import write_mission, written

_PROGRAM = "from tokt.cli import main; main()"
_RUN = "run --source dive --udp 127.0.0.1:{port}"
_CALIBRATIONS = ("calibration.opencv", "calibration.bouguet", "calibration.printed")

COMMANDS: dict[str, tuple[tuple[str, ...], str]] = {
    "deploy": (
        ("bundle.zip", "bundle.fields", "bundle.arrays", "bundle.words", "bundle.golden"),
        "deploy {file} made/store --reason fuzz",
    ),
    "run --bundle": (
        ("bundle.bytes", "bundle.manifest", "bundle.fields", "bundle.spec", "bundle.words"),
        f"{_RUN} --bundle {{file}} --policy texture --log made/run.jsonl",
    ),
    "run --store": (("store",), f"{_RUN} --store store --policy texture"),
    "store": (("store",), "store store --json"),
    "rollback": (("store",), "rollback store"),
    "labels import": (
        tuple(f"labels.{name}" for name in NAMES),
        "labels import {top} --mission-dir dive --workspace made/ws",
    ),
    "labels import --taxonomy": (
        ("taxonomy.toml",),
        "labels import sound/labels.csv --taxonomy {file} --workspace made/ws",
    ),
    "calibrate --check": (
        (*_CALIBRATIONS, "calibration.mat"),
        "calibrate dive --check --calibration {file}",
    ),
    "run --calibration": (_CALIBRATIONS, f"{_RUN} --policy disparity --calibration {{file}}"),
    "replay": (("run log", "recording"), "replay {top} --bundle sound.tokt"),
    "shadow": (("shadow log",), "shadow {file} --json"),
}
"""Kinds that a command is given, and its arguments: `file` is the input's, `top` its first part."""


def fault_of(code: int, out: str, err: str) -> str:
    """What is wrong with how a command ended, or an empty string."""
    if "Traceback" in out + err:
        return "a traceback"
    said = [line for line in err.splitlines() if line.startswith("tokt: error:")]
    if code == 2:
        if len(said) != 1:
            return f"{len(said)} lines of error"
        return "" if len(said[0]) <= MAX_LINE else "a line too long to read"
    if said:
        return f"exit code {code} with an error"
    return "" if code in (0, 1) else f"exit code {code}"


def _tree(box: Path) -> set[tuple[Path, int, int]]:
    """Every file with its size and time, but for what the command is there to write.

    The store it may lock and mend.
    """
    own = {box / "cwd" / "made", box / "cwd" / "store"}
    kept = [path for path in box.rglob("*") if path.is_file() and not own & {*path.parents}]
    return {(path, path.stat().st_size, path.stat().st_mtime_ns) for path in kept}


def _call(box: Path, files: Files, arguments: str, port: int) -> str:
    """Run a command in a box of its own; its refusal, empty where it did what was asked for.

    Beside the input lie a mission of two pairs, a sound bundle and a sound label file.
    """
    shutil.rmtree(box, ignore_errors=True)
    for name in ("cwd/made", "home", "tmp"):
        (box / name).mkdir(parents=True)
    cwd = box / "cwd"
    write_mission(cwd)
    sound = {
        "sound.tokt": small_bundles()[0][FILE],
        "sound/labels.csv": written("csv")["labels.csv"],
    }
    write_files({**sound, **files}, cwd)
    file = max(files)
    names = {"file": file, "top": file.partition("/")[0], "port": port}
    given = [argument.format(**names) for argument in arguments.split()]
    before = _tree(box)
    places = {"HOME": str(box / "home"), "TMPDIR": str(box / "tmp")}
    ran = run_python("-P", "-c", _PROGRAM, *given, folder=cwd, **places)
    fault = fault_of(ran.returncode, ran.stdout, ran.stderr)
    if beside := _tree(box) ^ before:
        fault = fault or f"files outside: {sorted(beside)}"
    if fault:
        ended = f"{fault}: tokt {' '.join(given)} in {cwd}"
        raise DefectError(f"{ended}\n{ran.stdout[-2000:]}\n{ran.stderr[-4000:]}")
    return ran.stderr if ran.returncode == 2 else ""


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_refuses_changed_inputs_in_one_line(command, tmp_path, try_cases):
    kinds, arguments = COMMANDS[command]
    with bound_socket() as receiver:
        port = receiver.getsockname()[1]

        def one(rng: Random) -> str:
            files = KINDS[rng.choice(kinds)].make(rng)
            return _call(tmp_path / "box", files, arguments, port)

        try_cases(one, few=0, share=0.03)
