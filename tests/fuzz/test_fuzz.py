"""A few cases of every kind, what failed once, and whether the fuzzer sees what it looks for."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from tokt.features.errors import LONGEST_MESSAGE, ToktError
from tokt.models.store import Store

from . import (
    bad_kinds,
    calibration_kinds,
    label_kinds,
    run_kinds,
    setting_kinds,
    store_kinds,
)
from .__main__ import counts, table
from .bundle_kinds import FILE, read_bundle_file
from .bundle_seeds import SPECS, real_bundle, small_bundles, whole_spec
from .case import GOOD, End, Kind, randomness, run_case, write_files
from .command_line import fault_of
from .fleet import Fleet
from .kinds import KINDS
from .sandbox import Sandbox

ONCE_FAILING = Path(__file__).parent / "once_failing"
"""``KIND/NAME/``: the files of an input that brought something down before it was mended."""

_SLOW = {"calibration.mat": 1, "bundle.real size": 3, "bundle.spec": 5, "store": 4}
_CASES = 12
SPEC = json.dumps(whole_spec(SPECS[0])).encode()


@pytest.fixture
def sandbox(tmp_path: Path) -> Sandbox:
    return Sandbox(tmp_path)


@pytest.mark.parametrize("name", KINDS)
def test_changed_inputs_are_read_or_refused_in_one_line(name: str, sandbox: Sandbox) -> None:
    kind = KINDS[name]
    for number in range(_SLOW.get(name, _CASES)):
        outcome = run_case(kind, kind.make(randomness(0, name, number)), sandbox)
        assert outcome.end in GOOD, (
            f"{outcome.words}\npython -m tests.fuzz --kind '{name}' --seed 0 --case {number}"
        )


@pytest.mark.parametrize(
    "folder", sorted(ONCE_FAILING.glob("*/*")), ids=lambda path: f"{path.parent.name}/{path.name}"
)
def test_what_failed_once_is_refused_now(folder: Path, sandbox: Sandbox) -> None:
    files = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    outcome = run_case(KINDS[folder.parent.name], files, sandbox)
    assert outcome.end == End.REFUSED, outcome.words


def test_what_the_changes_start_from_is_sound(tmp_path: Path) -> None:
    """Else every case would be refused for the same reason, and prove nothing."""
    for data in (*small_bundles(), real_bundle()):
        read_bundle_file({FILE: data}, tmp_path)
    for name, data in calibration_kinds._opencv_forms().items():
        calibration_kinds._read({f"c{Path(name).suffix}": data}, tmp_path)
    calibration_kinds._read({"c.txt": calibration_kinds._BOUGUET.encode()}, tmp_path)
    calibration_kinds._read({"c.json": json.dumps(calibration_kinds._PRINTED).encode()}, tmp_path)
    for name in label_kinds._AHEAD:
        ((path, data),) = label_kinds._written(name).items()
        for form, text in (("ours", data), ("theirs", label_kinds._foreign(name))):
            label_kinds._import({path: text}, tmp_path / name / form)
    setting_kinds._read_space({"space.toml": setting_kinds._SMALL, "mine.json": SPEC}, tmp_path)
    for data in run_kinds._datagrams():
        run_kinds._read_datagram({"datagram": data}, tmp_path)
    for files in store_kinds._stores():
        write_files(files, tmp_path)
        assert Store(tmp_path / "store").active().label == "fuzz/1"
        shutil.rmtree(tmp_path / "store")


@pytest.mark.parametrize("name", KINDS)
def test_a_case_follows_from_its_number(name: str) -> None:
    make = KINDS[name].make
    assert make(randomness(3, name, 8)) == make(randomness(3, name, 8))


# --- does it see what it looks for? ---


@pytest.mark.parametrize(
    ("read", "end"),
    [
        (bad_kinds.traceback, End.TRACEBACK),
        (bad_kinds.long, End.BAD_LINE),
        (bad_kinds.outside, End.OUTSIDE),
        (bad_kinds.outside_and_gone, End.OUTSIDE),
        (bad_kinds.warns, End.TRACEBACK),
        (bad_kinds.refuses, End.REFUSED),
    ],
)
def test_each_defect_is_seen(read, end: End, sandbox: Sandbox) -> None:
    kind = Kind("bad", "more", 1, bad_kinds.nothing, read)
    assert run_case(kind, {"file": b""}, sandbox).end == end


def test_a_crash_and_a_hang_cost_one_case_and_not_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2]))  # its processes import from there
    told: list[tuple[str, int, End, str]] = []
    fleet = Fleet(
        "tests.fuzz.bad_kinds",
        38,  # by this seed the second case of each is the bad one
        1,
        0.5,
        lambda kind, number, found: told.append((kind, number, found.end, found.words)),
    )
    rows = {row.kind: row.ends for row in fleet.run({"crash": 3, "hang": 3})}
    assert rows["crash"] == {End.ACCEPTED: 2, End.CRASH: 1}
    assert rows["hang"] == {End.ACCEPTED: 2, End.HANG: 1}
    assert [case[:3] for case in told] == [("crash", 1, End.CRASH), ("hang", 1, End.HANG)]
    words = "".join(case[3] for case in told)
    assert "SIGSEGV" in words and "in hang" in words


def test_counts_add_up_to_what_is_asked_for() -> None:
    found = counts(KINDS, {"bundles": 5000, "files": 20_000, "stores": 10, "more": 0})
    for group, total in (("bundles", 5000), ("files", 20_000), ("stores", 10)):
        cases = sum(found[kind.name] for kind in KINDS.values() if kind.group == group)
        assert total <= cases <= total + len(KINDS)
    assert found["calibration.mat"] == 200 and table([]).startswith("kind")


@pytest.mark.parametrize(
    ("code", "err", "fault"),
    [
        (2, "tokt: error: no\n", ""),
        (0, "note: odd\n", ""),
        (2, "tokt: error: no\ntokt: error: no\n", "2 lines of error"),
        (2, "Usage:\n", "0 lines of error"),
        (1, "Traceback (most recent call last):\n", "a traceback"),
        (-11, "", "exit code -11"),
    ],
)
def test_how_a_command_may_end(code: int, err: str, fault: str) -> None:
    assert fault_of(code, "", err) == fault


# --- the message of every error ---


@pytest.mark.parametrize("text", ["a\nb\r\tc", "\x1b[2J", "\ud800", "x" * 5000, "é\x00" * 900])
def test_an_error_is_one_printable_line(text: str) -> None:
    message = str(ToktError(f"file {text} is bad"))
    assert message.isprintable() and message.startswith("file ") and message.endswith(" is bad")
    assert len(message) <= LONGEST_MESSAGE and str(ToktError(message)) == message
