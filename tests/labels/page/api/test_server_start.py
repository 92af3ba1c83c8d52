"""How `tokt label` starts, refuses to start, and ends."""

import http.client
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.calls import refused, run_python
from tests.inference.test_faults import hold_row
from tests.waiting import MAX_S, until
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.page.state.session import open_session
from tokt.labels.record import LabelRecord, utc_now
from tokt.labels.store.store import LabelStore


def test_ctrl_c_ends_it_though_pages_listen(page_server):
    server = page_server("--annotator", "anna")
    token = (server.workspace / "page-token").read_text().strip()
    assert server.url == f"http://127.0.0.1:{server.port}/?token={token}"
    _check_nothing_heavy_is_loaded(server.process.pid)
    with ExitStack() as opened:
        streams = [opened.enter_context(server.events(who="anna")) for _ in range(5)]
        for stream in streams:
            stream.next("status")
        server.process.send_signal(signal.SIGINT)
        assert server.process.wait(MAX_S) == 0  # its pages alone would keep it for ever
        assert all(name == "status" for stream in streams for name, _ in stream.rest())
    assert server.process.stdout.read() == "" == server.process.stderr.read()
    server.start()  # the port is free again
    server.process.send_signal(signal.SIGTERM)
    assert server.process.wait(MAX_S) == 0


LAST = "tokt.labels.page.api.serve"
STARTING = ("typer", "numpy", "fastapi.applications", LAST)


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to a single process")
@pytest.mark.parametrize("module", STARTING)
def test_ctrl_c_while_it_starts_prints_nothing(tiny, tmp_path, module):
    command = [sys.executable, "-X", "importtime", "-c", "from tokt.cli import main; main()"]
    command += ["label", str(tiny.path), "--no-browser", "--port", "0", "--workspace", tmp_path]
    # A shell lets what it starts in the background ignore Ctrl-C, tests and all.
    heeded = {"preexec_fn": partial(signal.signal, signal.SIGINT, signal.SIG_DFL)}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **heeded) as process:
        names = (line.split()[-1] for line in process.stderr)
        found = next(name for name in names if name in (module, LAST))
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
    assert found == module and "Traceback" not in rest and "Interrupt" not in rest, rest
    assert all(line.startswith("import time:") for line in rest.splitlines()), rest
    # Before the command, within it, or once it served.
    assert process.returncode in (-signal.SIGINT, 130, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to a single process")
@pytest.mark.parametrize("wait_s", [0, 0.05])
def test_ctrl_c_twice_ends_it_in_order(page_server, tmp_path, wait_s):
    server = page_server(workspace=tmp_path)
    with server.events(who="anna") as stream:
        stream.next("status")
        server.paint("c-1", 1, [5], "ocean")
        for _ in range(2):
            server.process.send_signal(signal.SIGINT)
            time.sleep(wait_s)
        assert server.process.wait(MAX_S) == 0
    assert server.process.stdout.read() == "" == server.process.stderr.read()
    with LabelStore(tmp_path / "labels.db") as store:
        assert [record.label for record in store.current("tiny")] == ["ocean"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a file that is never read to its end")
@pytest.mark.parametrize("suggests", [False, True], ids=["picture", "suggestion"])
def test_ctrl_c_while_a_frame_takes_for_ever(page_server, tiny, tiny_bundle, tmp_path, suggests):
    mission = tmp_path / "dive"
    shutil.copytree(tiny.path, mission)
    server = page_server(*(["--model", tiny_bundle] if suggests else []), mission=mission)
    server.paint("c-1", 1, [5], "ocean")
    frame = max((mission / "Left").iterdir(), key=lambda file: int(file.stem.rpartition("_")[2]))
    number = int(frame.stem.rpartition("_")[2])
    frame.unlink()
    os.mkfifo(frame)
    with closing(server.connect()) as asking:
        asking.request("GET", f"/api/picture/left/{number}", headers=server.authority)
        with frame.open("wb"):  # once somebody reads it; as long as it is open, that takes
            server.process.send_signal(signal.SIGINT)
            assert server.process.wait(MAX_S) == 0
    assert server.process.stdout.read() == "" == server.process.stderr.read()
    with LabelStore(server.workspace / "labels.db") as store:
        assert [record.label for record in store.current(mission.name)] == ["ocean"]
    hold_row(
        "Ctrl-C or SIGTERM while `tokt label` works on a frame that takes long",
        "ends within 3 s, code 0, nothing printed; labels that were answered are stored",
        "nothing",
    )


def _check_nothing_heavy_is_loaded(process):
    maps = Path(f"/proc/{process}/maps")
    if maps.exists():  # on Linux
        loaded = {part for line in maps.read_text().splitlines() for part in line.split("/")}
        assert "numpy" in loaded
        assert not loaded & {"sklearn", "pandas", "pyarrow", "matplotlib", "scipy", "skimage"}


def test_port_that_is_taken(run_tokt, tiny, tmp_path):
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        ran = run_tokt("label", tiny.path, "--port", port, "--no-browser", "--workspace", tmp_path)
    assert ran.code == 2 and ran.out == ""
    assert ran.err.startswith(f"tokt: error: port {port} is taken")
    assert ran.err.endswith("choose another with --port\n")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--host", "192.0.2.1"], "192.0.2.1 is not an address of this computer"),
        (["--host", "no.such.host.invalid"], "no.such.host.invalid"),
        (["--annotator", " x"], "annotator ' x'"),
        (["--grid", "10"], "not a grid"),
        (["--grid", "100x100@360"], "the least is 3x3"),
        (["--token", ""], "--token is empty"),
        (["--token", "t", "--no-token"], "--token and --no-token exclude each other"),
        (["--host", "0.0.0.0", "--no-token"], "--no-token is for this computer alone"),
        (["--model", "missing.tokt"], "missing.tokt"),
        (["--taxonomy", "missing.toml"], "missing.toml"),
    ],
)
def test_options_that_cannot_be_used(tiny, tmp_path, options, said):
    fixed = ("--port", 0, "--no-browser", "--workspace", tmp_path / ".tokt")
    assert refused(said, "label", tiny.path, *fixed, *options).count("\n") == 1


def test_missions_that_cannot_be_used(tiny, tmp_path):
    picture = next((tiny.path / "Left").iterdir())
    fixed = ("--port", 0, "--no-browser", "--workspace", tmp_path / "w")
    for folder, file in ((" blanks ", "a_1.png"), ("empty", "a.txt")):
        (tmp_path / folder).mkdir()
        shutil.copy(picture, tmp_path / folder / file)
        assert refused("", "label", tmp_path / folder, *fixed).count("\n") == 1, folder


def test_a_model_of_another_grid(tiny, tiny_bundle, tmp_path):
    fixed = ("--port", 0, "--no-browser", "--workspace", tmp_path / ".tokt")
    other = ("--grid", "5x5", "--model", tiny_bundle)
    assert "5x5@360" in refused("10x10@360", "label", tiny.path, *fixed, *other)


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit on the size of files")
def test_a_store_that_cannot_be_written(tiny, tmp_path):
    LabelStore(tmp_path / "labels.db").close()
    options = ("--port", 0, "--no-browser", "--workspace", tmp_path)
    ran = run_python("-c", _LIMITED, "label", tiny.path, *options)
    assert ran.returncode == 2 and ran.stdout == "", ran.stderr
    assert ran.stderr.startswith(f"tokt: error: label store {tmp_path / 'labels.db'}: ")
    assert ran.stderr.count("\n") == 1


_LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
from tokt.cli import main
main()
"""


def test_other_grids_are_other_labels(page_server, tmp_path):
    with LabelStore(tmp_path / "labels.db") as store:
        for grid in (Grid(), Grid(2, 2)):
            store.add([LabelRecord("tiny", "left", 1, grid, 1, 1, "reef", "anna", utc_now())])
    server = page_server("--grid", "5x4@360", workspace=tmp_path)
    mission = server.get("/api/mission", who="anna")
    assert mission["grid"] == {"rows": 5, "cols": 4, "width": 360}
    assert mission["counts"]["reef"] == 0 and mission["other_grids"] == 2
    server.paint("g-1", 1, [19], "ocean")


def test_little_space_is_said(tiny, tmp_path, monkeypatch):
    mission = open_mission(tiny.path)
    with closing(open_session(mission, tmp_path, Grid(), "anna", "1")) as session:
        assert session.fault == "" == session.status()["fault"]
        monkeypatch.setattr("tokt.labels.page.state.session.LITTLE_BYTES", 10**18)
        assert str(tmp_path / "labels.db") in session.find_fault()
        assert "almost full" in session.status()["fault"]


@pytest.mark.skipif(os.name != "posix", reason="needs a shell script")
def test_the_browser_is_opened(page_host, tiny, tmp_path, monkeypatch):
    script, opened = tmp_path / "browser", tmp_path / "opened"
    script.write_text(f'#!/bin/sh\necho "$1" > {opened}.part && mv {opened}.part {opened}\n')
    script.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{script} %s")
    options = ("--port", 0, "--workspace", tmp_path / "w", "--token", "t&t")
    process = page_host.start("label", tiny.path, *options)
    line = process.stdout.readline()
    until(opened.exists)
    printed = next(word for word in line.split() if word.endswith("/?token=t%26t"))
    url = urlsplit(opened.read_text().strip())  # which other accounts see, and come too late
    assert printed.partition("?")[0] == f"{url.scheme}://{url.netloc}/"
    assert "t%26t" not in url.query
    for status in (303, 401):
        with closing(http.client.HTTPConnection(url.netloc, timeout=MAX_S)) as connection:
            connection.request("GET", f"/?{url.query}")
            assert connection.getresponse().status == status
    process.send_signal(signal.SIGINT)
    assert process.wait(MAX_S) == 0
    process.stdout.close()
    process.stderr.close()
