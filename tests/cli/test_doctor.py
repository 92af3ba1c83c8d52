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

from tests.calls import free_port, refuses, run_python, succeeds
from tests.features.kernels.each_kernel import changed
from tokt.cli import doctor as doctor_module
from tokt.cli.doctor import missing_packages
from tokt.features.common import atomic
from tokt.features.common.sqlite_copy import copy_database
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.health import compared, kernel_findings
from tokt.inference.sources.cameras.vimba.system import camera_driver_finding


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


@pytest.fixture
def labelled(workspace, tiny):
    succeeds("labels", "import", tiny.labels, "--workspace", workspace)
    return workspace


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
    assert found["labels"]["events"] == 4000 and found["labels"]["format"] == 3
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


@pytest.mark.process
def test_mlflow_is_not_imported_without_a_registry(tmp_path):
    program = (
        "import sys; from tokt.cli import app; app(['doctor'], standalone_mode=False);"
        "print([name for name in ('mlflow', 'sklearn', 'pandas') if name in sys.modules])"
    )
    done = run_python("-c", program, folder=tmp_path)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "[]")


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


@pytest.mark.parametrize("name", ["library", "numpy"])
@pytest.mark.process
def test_kernels_that_were_asked_for(name, tmp_path, tokt_without):
    done = tokt_without((), tmp_path, "doctor", "--json", TOKT_KERNELS=name)
    assert done.returncode == 0, done.stdout + done.stderr
    found = by_name(done.stdout)
    assert found["kernels"]["kernels"] == found["kernels"]["variable"] == name
    assert f"TOKT_KERNELS={name}" in found["kernels"]["text"]
    others = [value for value in found.values() if "compared_with" in value]
    assert others and {value["compared_with"] for value in others} == {name}
    assert {value["lbp_difference"] for value in others} == {0}


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


@pytest.mark.process
def test_kernels_of_libraries_that_are_not_installed_are_a_note(tmp_path, tokt_without):
    libraries = ("skimage", "skimage.feature", "mahotas")
    done = tokt_without(libraries, tmp_path, "doctor", "--json", TOKT_KERNELS="")
    assert (done.returncode, done.stderr) == (0, "")
    library = by_name(done.stdout)["library kernels"]
    assert library["state"] == "note" and "not on this machine" in library["text"]


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
        (lambda store: (shutil.rmtree(store), store.write_text("")), {"store"}),
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


@pytest.mark.parametrize(("name", "finding"), [("mlflow.db", "registry"), ("labels.db", "labels")])
@pytest.mark.parametrize("how", ["no database", "cut", "a folder"])
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


@pytest.mark.process
def test_a_registry_server_that_is_down_is_a_fault(tmp_path, tokt_without):
    uri = f"http://me:secret@127.0.0.1:{free_port()}"
    once = {"MLFLOW_TRACKING_URI": uri, "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "0"}
    done = tokt_without((), tmp_path, "doctor", "--json", **once)
    assert done.returncode == 1
    assert by_name(done.stdout)["registry"]["state"] == "fault"
    assert "secret" not in done.stdout + done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_database_that_never_rests_is_said(tmp_path, monkeypatch):
    (tmp_path / "a.db").write_bytes(b"")
    times = iter(range(100))
    monkeypatch.setattr("tokt.features.common.sqlite_copy._state", lambda source: next(times))
    refuses("is being written to", copy_database, tmp_path / "a.db", tmp_path / "copy.db")


def test_missing_packages():
    assert missing_packages("tokt", "train") == []
    assert "distributed" not in missing_packages("tokt", "cluster")
    assert missing_packages("tokt", "no such extra") == []


def test_missing_packages_of_an_extra_of_an_extra(tmp_path, monkeypatch):
    for name, wants in {"aa": 'bb[x]>=1; extra == "all"', "bb": 'cc<3,>=2; extra == "x"'}.items():
        folder = tmp_path / f"{name}-1.dist-info"
        folder.mkdir()
        text = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\nRequires-Dist: {wants}\n"
        (folder / "METADATA").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    assert missing_packages("aa", "all") == ["cc"]
    shutil.rmtree(tmp_path / "bb-1.dist-info")
    assert missing_packages("aa", "all") == ["bb"]


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
    ("code", "state", "words"),
    [
        ("version[0] = 1; version[1] = 8; version[2] = 3; return 0;", "ok", "with VimbaC 1.8.3"),
        ("abort();", "fault", "cannot be used: ended with -6"),
        ("return -4;", "fault", "cannot be used"),
        ("sleep(60); return 0;", "fault", "does not answer in 2 s"),
    ],
    ids=["sound", "crash", "error", "hang"],
)
@needs_vimba_like
def test_the_camera_library(code, state, words, tmp_path, monkeypatch):
    make_vimba(tmp_path, code)
    place = tmp_path / "VimbaGigETL" / "CTI" / "x86_64bit"
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(place))
    found = camera_driver_finding(timeout_s=2.0 if "sleep" in code else 60.0)
    assert found.state == state and words in found.text, found


@needs_vimba_like
def test_a_camera_library_that_is_none(tmp_path, monkeypatch):
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    assert camera_driver_finding().state == "note"
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(tmp_path / "Tl" / "CTI" / "x86_64bit"))
    found = camera_driver_finding()
    assert found.state == "note" and "No libVimbaC.so found" in found.text
    library = tmp_path / "VimbaC" / "DynamicLib" / "x86_64bit" / "libVimbaC.so"
    library.parent.mkdir(parents=True)
    library.write_text("not a library")
    found = camera_driver_finding()
    assert found.state == "fault" and "libVimbaC.so" in found.text


def test_no_pymba_is_a_note(monkeypatch):
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if "site-packages" not in entry])
    assert camera_driver_finding().text.startswith("no pymba")


def test_the_extra_for_video_names_ffmpeg(monkeypatch):
    assert re.fullmatch(r"PyAV \d.* with FFmpeg \S+, aiortsp \d.*", doctor_module._video().text)
    monkeypatch.setattr(doctor_module, "missing_packages", lambda *_: ["av"])
    assert doctor_module._video().text == "missing: av"


def test_each_extra_of_the_product_has_a_line(doctor):
    """Those for who works on tokt are no user's."""
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    extras = set(project["project"]["optional-dependencies"]) - doctor_module._NO_USER_S
    found = doctor()[1]
    assert {f"extra {extra}" for extra in extras} <= set(found)
