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
    ("seconds", "lines"),
    [
        (0.01, ["trials: 2/8", "trials: 4/8", "trials: 6/8", "trials: 8/8"]),
        (
            20.0,
            [
                "trials: 2/8, about 2 min left",
                "trials: 4/8, about 2 min left",
                "trials: 6/8, about 1 min left",
                "trials: 8/8",
            ],
        ),
        (
            3600.0,
            [
                "trials: 1/8, about 7 h left",
                "trials: 2/8, about 6 h left",
                "trials: 3/8, about 5 h left",
                "trials: 4/8, about 4 h left",
                "trials: 5/8, about 3 h left",
                "trials: 6/8, about 2 h left",
                "trials: 7/8, about 60 min left",
                "trials: 8/8",
            ],
        ),
    ],
)
def test_lines_each_quarter_and_each_half_minute(clock, capsys, seconds, lines):
    items = []
    for item in output.progress(range(8), 8, "trials"):
        items.append(item)
        clock[0] += seconds
    assert items == list(range(8))
    assert capsys.readouterr().err.splitlines() == lines


@pytest.mark.skipif(os.name != "posix", reason="a pipe without a reader is another error elsewhere")
def test_lines_that_nobody_reads_end_nothing():
    reader, writer = os.pipe()
    os.close(reader)
    program = "from tokt.cli.output import say; say('one'); say('two'); print('done')"
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=writer, check=False)
    os.close(writer)
    assert (done.returncode, done.stdout) == (0, b"done\n")
