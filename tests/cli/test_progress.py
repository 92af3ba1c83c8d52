"""Progress where there is no terminal: few lines, and how long it will take."""

import os
import subprocess
import sys

import pytest

from tokt.cli import output


@pytest.fixture
def clock(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(output.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(
    ("seconds", "left"),
    [
        (0.01, {2: "", 4: "", 6: ""}),
        (20.0, {2: "2 min", 4: "2 min", 6: "1 min"}),
        (3600.0, {**{n: f"{8 - n} h" for n in range(1, 7)}, 7: "60 min"}),
    ],
)
def test_lines_each_quarter_and_each_half_minute(clock, capsys, seconds, left):
    items = []
    for item in output.progress(range(8), 8, "trials"):
        items.append(item)
        clock[0] += seconds
    assert items == list(range(8))
    lines = [
        f"trials: {n}/8" + (f", about {time} left" if time else "") for n, time in left.items()
    ]
    assert capsys.readouterr().err.splitlines() == [*lines, "trials: 8/8"]


@pytest.mark.skipif(os.name != "posix", reason="a pipe without a reader is another error elsewhere")
def test_lines_that_nobody_reads_end_nothing():
    reader, writer = os.pipe()
    os.close(reader)
    program = "from tokt.cli.output import say; say('one'); say('two'); print('done')"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=writer, check=False)
    os.close(writer)
    assert (done.returncode, done.stdout) == (0, b"done\n")
