"""`tokt doctor`: what it finds, its exit code at a fault, and that it changes nothing."""

import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest

from tests.calls import succeeds
from tests.features.kernels.each_kernel import changed
from tokt.cli import doctor as doctor_module
from tokt.features.common import atomic
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.health import compared, kernel_findings
from tokt.inference.sources.cameras.vimba.system import camera_driver_finding

pytestmark = pytest.mark.process  # it tries out each camera's driver in a process


def listing(folder):
    """Every file and folder below, with its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def by_name(out):
    value = json.loads(out)
    faults = [item for item in value["findings"] if item["state"] == "fault"]
    assert value["ok"] is (faults == [])
    found = {item["name"]: item for item in value["findings"]}
    assert len(found) == len(value["findings"])
    return found


@pytest.fixture
def store(tiny_bundle, tmp_path):
    succeeds("deploy", tiny_bundle, tmp_path / "store")
    return tmp_path / "store"


@pytest.fixture(scope="module")
def labelled_once(trained, tiny, tmp_path_factory):
    workspace = shutil.copytree(trained, tmp_path_factory.mktemp("labelled") / ".tokt")
    succeeds("labels", "import", tiny.labels, "--workspace", workspace)
    return workspace


@pytest.fixture
def labelled(labelled_once, tmp_path):
    """A workspace with a model and 4000 labels that a test may change."""
    return shutil.copytree(labelled_once, tmp_path / ".tokt")


@pytest.fixture
def doctor(tmp_path, run_tokt, monkeypatch):
    """Its exit code and findings; nothing on the disk is changed by it."""
    monkeypatch.chdir(tmp_path)

    def run(*options):
        before = listing(tmp_path)
        ran = run_tokt("doctor", *options, "--json")
        assert (listing(tmp_path), ran.err) == (before, "")
        return ran.code, by_name(ran.out)

    return run


def test_everything_sound(labelled, store, tmp_path, doctor):
    code, found = doctor("--store", store, "--workspace", labelled)
    assert code == 0
    assert found["kernels"]["kernels"] == KERNELS.name
    assert found["store active"]["model"] == "tiny-lbp/1" and found["store active"]["load_s"] > 0
    assert found["store versions"]["versions"] == 1
    assert found["labels"]["events"] == 4000 and found["labels"]["format"] == 4
    assert (found["registry"]["models"], found["registry"]["versions"]) == (1, 1)
    assert found["workspace"]["free_bytes"] > 0
    names = ("store", "store active", "store versions", "labels", "registry", "numpy", "opencv")
    assert {found[name]["state"] for name in names} == {"ok"}
    assert str(tmp_path / ".tokt" / "mlflow.db") in found["registry"]["text"]


def test_an_empty_place_in_lines(tmp_path, run_tokt, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran = run_tokt("doctor")
    assert (ran.code, ran.err, list(tmp_path.iterdir())) == (0, "", [])
    lines = ran.out.splitlines()
    assert all(re.fullmatch(r"(ok   |note )  [\w ]+: \S.*", line) for line in lines), ran.out
    assert any("registry: no registry yet" in line for line in lines)
    assert any("labels: no labels yet" in line for line in lines)
    assert not any("store" in line for line in lines)


def test_a_label_store_in_use_keeps_its_bytes(labelled, doctor):
    """Its latest events are still in the write-ahead log of the process that has it open."""
    with sqlite3.connect(labelled / "labels.db") as other:
        other.execute(
            "INSERT INTO events (mission, camera, frame, grid, row, col, label, annotator, time,"
            " source) SELECT mission, camera, frame, grid, row, col, label, 'other', time, source"
            " FROM events LIMIT 1"
        )
        other.commit()
        assert (labelled / "labels.db-wal").stat().st_size
        _, found = doctor("--workspace", labelled)
    other.close()
    assert found["labels"]["events"] == 4001


@pytest.mark.process
def test_wrong_kernels_are_a_fault_and_the_rest_is_shown(store, tmp_path, tokt_without):
    command = ("doctor", "--store", store, "--json")
    done = tokt_without((), tmp_path, *command, TOKT_KERNELS="nonsense")
    assert (done.returncode, done.stderr) == (1, "")
    found = by_name(done.stdout)
    assert [name for name, value in found.items() if value["state"] == "fault"] == ["kernels"]
    assert "TOKT_KERNELS=nonsense: unknown kernels" in found["kernels"]["text"]
    assert found["store active"]["state"] == "ok"
    assert found["registry"]["state"] == "note"
    done = tokt_without((), tmp_path, "doctor", TOKT_KERNELS="nonsense")
    assert done.returncode == 1 and "\nfault  kernels: TOKT_KERNELS=nonsense" in done.stdout


def test_the_kernels_of_this_machine_agree():
    first, *others = kernel_findings()
    assert first.state in ("ok", "note") and len(others) == 2
    assert all(item.state == "ok" for item in others), others


def test_kernels_that_differ_are_a_fault():
    def with_wrong(name, spoil):
        kernel = getattr(KERNELS, name)
        wrong = changed(KERNELS, **{name: lambda *given, **more: spoil(kernel(*given, **more))})
        return compared(KERNELS, wrong)

    def one_count_off(counts):
        counts[0, 0] += 1
        return counts

    assert compared(KERNELS, KERNELS).state == "ok"
    counts = with_wrong("lbp_counts", one_count_off)
    assert counts.figures["lbp_difference"] == 4 and "LBP counts: 4" in counts.text
    near = with_wrong("haralick_features", lambda features: features * (1 + 2e-9))
    assert near.figures["haralick_relative_difference"] == pytest.approx(2e-9, rel=1e-3)
    lost = with_wrong("haralick_features", lambda features: features * np.nan)
    assert lost.figures["haralick_relative_difference"] is None
    gray = with_wrong("resized_gray", lambda image: image ^ 1)
    assert gray.figures["gray_difference"] == 54 * 72
    assert {found.state for found in (counts, near, lost, gray)} == {"fault"}


def spoil_bundle(store):
    (file,) = store.glob("versions/*/bundle.tokt")
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


def rename_version(store):
    (folder,) = store.glob("versions/*")
    shutil.copytree(folder, folder.with_name("0" * 64))


@pytest.mark.parametrize(
    ("spoil", "faults"),
    [
        (spoil_bundle, {"store active", "store versions"}),
        (rename_version, {"store versions"}),
        (lambda store: shutil.rmtree(store / "versions"), {"store active"}),
        (lambda store: (store / "active").write_text("{"), {"store", "store active"}),
        (lambda store: (store / "history.jsonl").write_text("?\n?\n"), {"store"}),
        (lambda store: shutil.rmtree(store), {"store"}),
    ],
)
def test_a_damaged_store(spoil, faults, store, doctor):
    spoil(store)
    code, found = doctor("--store", store)
    assert code == 1
    assert {name for name, value in found.items() if value["state"] == "fault"} == faults
    assert all("\n" not in value["text"] for value in found.values())


def test_half_written_files_and_an_empty_store(store, tmp_path, doctor):
    with atomic.scratch_folder(store / "active"):
        code, found = doctor("--store", store, "--workspace", tmp_path / "no")
    assert (code, found["store partial files"]["files"]) == (0, 1)
    (tmp_path / "new").mkdir()
    code, found = doctor("--store", tmp_path / "new", "--workspace", tmp_path / "no")
    assert code == 0 and found["store active"]["state"] == "note"
    assert "store partial files" not in found


@pytest.mark.parametrize(
    ("name", "finding", "how"),
    [
        ("mlflow.db", "registry", "cut"),
        ("mlflow.db", "registry", "no database"),
        ("labels.db", "labels", "cut"),
        ("labels.db", "labels", "a folder"),
    ],
)
def test_a_damaged_database(name, finding, how, labelled, doctor):
    file = labelled / name
    whole = file.read_bytes()
    if how == "no database":
        file.write_bytes(b"this is no database" * 100)
    elif how == "cut":
        file.write_bytes(whole[: len(whole) // 2])
    else:
        file.unlink()
        file.mkdir()
    code, found = doctor("--workspace", labelled)
    assert code == 1
    faults = [value for value in found.values() if value["state"] == "fault"]
    assert [fault["name"] for fault in faults] == [finding]
    assert str(file) in faults[0]["text"] and "\n" not in faults[0]["text"]


def test_databases_of_other_programs_and_versions(labelled, doctor):
    with sqlite3.connect(labelled / "labels.db") as labels:
        labels.execute("PRAGMA user_version = 99")
    labels.close()
    with sqlite3.connect(labelled / "mlflow.db") as registry:
        registry.execute("UPDATE alembic_version SET version_num = 'of the future'")
    registry.close()
    code, found = doctor("--workspace", labelled)
    assert code == 1
    assert "has format 99, newer than" in found["labels"]["text"]
    assert found["registry"]["state"] == "fault"
    for name, file in (("labels", "labels.db"), ("registry", "mlflow.db")):
        assert str(labelled / file) in found[name]["text"]


@pytest.mark.process
def test_a_registry_without_mlflow_is_a_note(labelled, tokt_without):
    done = tokt_without(["mlflow"], labelled, "doctor", "--json", "--workspace", ".")
    assert (done.returncode, done.stderr) == (0, "")
    registry = by_name(done.stdout)["registry"]
    assert registry["state"] == "note" and "extra 'train'" in registry["text"]


def test_the_registry_that_the_environment_names(labelled, tmp_path, doctor, monkeypatch):
    elsewhere = tmp_path / "elsewhere.db"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{elsewhere}")
    _, found = doctor("--workspace", labelled)
    assert found["registry"]["state"] == "note" and not elsewhere.exists()
    shutil.copy(labelled / "mlflow.db", elsewhere)
    _, found = doctor("--workspace", tmp_path / "none")
    assert found["registry"]["versions"] == 1
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "postgresql://me:secret@host/db")
    _, found = doctor("--workspace", labelled)
    assert found["registry"]["state"] == "note"
    assert "secret" not in str(found) and "***@host" in str(found)


needs_vimba_like = pytest.mark.skipif(
    not sys.platform.startswith("linux")
    or os.uname().machine != "x86_64"
    or shutil.which("cc") is None,
    reason="makes a library like Vimba's with the C compiler of 64-bit Linux",
)


def make_vimba(folder, code):
    """A library with every function that pymba looks up; `code` is its version function's body."""
    pymba = distribution("pymba").locate_file("pymba/vimba_c.py")
    names = set(re.findall(r"_vimba_lib\.(\w+)", Path(str(pymba)).read_text()))
    functions = "".join(f"int {name}(void) {{ return 0; }}\n" for name in names)
    functions = functions.replace(
        "int VmbVersionQuery(void) { return 0; }",
        f"int VmbVersionQuery(unsigned *version, unsigned size) {{ {code} }}",
    )
    source = folder / "vimba.c"
    source.write_text(f"#include <stdlib.h>\n#include <unistd.h>\n{functions}")
    library = folder / "VimbaC" / "DynamicLib" / "x86_64bit" / "libVimbaC.so"
    library.parent.mkdir(parents=True)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source], check=True)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("abort();", "cannot be used: ended with -6"),
        ("sleep(60); return 0;", "does not answer in 0.5 s"),
    ],
    ids=["crash", "hang"],
)
@needs_vimba_like
def test_a_camera_library_that_crashes_or_hangs(code, words, tmp_path, monkeypatch):
    make_vimba(tmp_path, code)
    place = tmp_path / "VimbaGigETL" / "CTI" / "x86_64bit"
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(place))
    found = camera_driver_finding(timeout_s=0.5 if "sleep" in code else 60.0)
    assert found.state == "fault" and words in found.text, found


def test_each_extra_of_the_product_has_a_line(doctor):
    """Those for who works on tokt are no user's."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    extras = set(project["project"]["optional-dependencies"]) - doctor_module._NO_USER_S
    found = doctor()[1]
    assert {f"extra {extra}" for extra in extras} <= set(found)
