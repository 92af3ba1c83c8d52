"""Changed inputs of every kind, what failed once, and whether each defect is seen."""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import Phase

from tests.calls import run_python
from tokt.features.common.errors import MAX_MESSAGE, ToktError
from tokt.models.store.store import Store

from . import bundles, stores
from .case import MAX_LINE, DefectError, Kind, write_files
from .conftest import KINDS

ONCE_FAILING = Path(__file__).parent / "once_failing"
"""``KIND/NAME/``: the files of an input that brought something down before it was mended."""


@pytest.mark.parametrize("name", KINDS)
def test_changed_inputs_are_read_or_refused_in_one_line(name, box, try_cases):
    kind = KINDS[name]
    try_cases(lambda rng: box.read(kind, kind.make(rng)), kind.few, kind.share, Phase.shrink)


@pytest.mark.parametrize(
    "folder", sorted(ONCE_FAILING.glob("*/*")), ids=lambda path: f"{path.parent.name}/{path.name}"
)
def test_what_failed_once_is_refused_now(folder, box):
    paths = [path for path in folder.rglob("*") if path.is_file()]
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
    assert box.read(KINDS[folder.parent.name], files)


def test_what_the_changes_start_from_is_sound(tmp_path):
    """Else every case would be refused for the same reason, and prove nothing."""
    # A sound store refuses what is not signed, and what it has rolled back from.
    sound = {(kind.seeds, kind.read): None for kind in KINDS.values() if kind.name != "store"}
    cases = [(read, files) for seeds, read in sound for files in seeds()]
    cases += [(_active_label, files) for files in stores.stores()]
    for number, (read, files) in enumerate(cases):
        write_files(files, tmp_path / str(number))
        read(tmp_path / str(number))
    assert len(bundles.small_bundles()) == 13, "a bundle of an older format is not there"


def _active_label(folder: Path) -> None:
    assert Store(folder / stores.HOME).active().label == "fuzz/1"


def _refusing(text: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        error = ToktError("short")
        error.args = (text,)
        raise error

    return read


def _outside_and_gone(folder: Path) -> object:
    (folder.parents[1] / "gone").write_bytes(b"")
    return (folder.parents[1] / "gone").unlink()


def _beside_unseen(folder: Path) -> object:
    """As native code would, of which Python's audit events do not tell."""
    return subprocess.run(["touch", str(folder.parent / "beside")], check=True)


def _kind(read: Callable[[Path], object]) -> Kind:
    seeds = [{"file": b"%d" % number} for number in range(10)]
    return Kind("bad", lambda: seeds, read, 1, change=lambda files, rng, others: files)


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda folder: {}["missing"], "KeyError: 'missing'"),
        (_refusing("x" * (MAX_LINE + 1)), "a message of 1001 characters"),
        (_refusing("one\ntwo"), "control characters"),
        (lambda folder: (folder.parent / "beside").write_bytes(b""), "outside: .*/beside"),
        (_outside_and_gone, "outside: open .*/gone"),
        (_beside_unseen, "outside: subprocess.Popen"),
        (_beside_unseen, "outside: /.*/beside"),
        (lambda folder: warnings.warn("careful", stacklevel=1), "warning: careful"),
        (lambda folder: bytearray(1 << 40), "MemoryError"),
    ],
)
def test_each_defect_is_seen(read, words, box):
    with pytest.raises(DefectError, match=words):
        box.read(_kind(read), {"file": b""})
    again = box.read(_kind(_refusing("no good")), {"file": b""})
    assert again == "no good", "the next case suffers from it"


def test_the_smallest_failing_input_is_kept(box, try_cases):
    def read(folder: Path) -> object:
        return 1 / (int((folder / "file").read_bytes()) < 3)

    kind = _kind(read)
    with pytest.raises(DefectError, match="the input is kept in"):
        try_cases(lambda rng: box.read(kind, kind.make(rng)), 50, 0, Phase.shrink)
    assert (box.case / "file").read_bytes() == b"3"


@pytest.mark.parametrize(
    ("body", "words"),
    [("os.kill(os.getpid(), signal.SIGSEGV)", "Segmentation fault"), ("time.sleep(60)", "Timeout")],
)
def test_a_crash_and_a_hang_show_where_and_leave_the_input(body, words, tmp_path):
    """They end the process: pytest-xdist says which test it was and begins another."""
    program = f"""
import faulthandler, os, pathlib, signal, sys, time
from tests.fuzz import case
case.HANG_S = 0.5
faulthandler.enable()  # as pytest does
def bad(folder):
    {body}
kind = case.Kind("bad", None, bad, 1)
case.Box(pathlib.Path(sys.argv[1])).read(kind, {{"file": b"3"}})
"""
    root = Path(__file__).parents[2]
    ended = run_python("-c", program, tmp_path, folder=root, PYTHONPATH=os.pathsep.join(sys.path))
    assert ended.returncode != 0
    assert words in ended.stderr and "in bad" in ended.stderr
    assert (tmp_path / "cwd" / "case" / "file").read_bytes() == b"3"


@pytest.mark.parametrize("text", ["a\nb\r\tc", "\x1b[2J", "\ud800", "x" * 5000, "é\x00" * 900])
def test_an_error_is_one_printable_line(text):
    message = str(ToktError(f"file {text} is bad"))
    assert message.isprintable() and message.startswith("file ") and message.endswith(" is bad")
    assert len(message) <= MAX_MESSAGE and str(ToktError(message)) == message
