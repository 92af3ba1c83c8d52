"""The service file is one that systemd takes, and gives the run little more than it needs."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

SERVICE = Path(__file__).parents[2] / "docs" / "tokt.service"
ANALYZE = shutil.which("systemd-analyze")
MAX_EXPOSURE = 2.0  # of 10; 9.6 without the restrictions

pytestmark = pytest.mark.skipif(ANALYZE is None, reason="no systemd-analyze")


def analyze(*words):
    return subprocess.run([ANALYZE, *words], capture_output=True, text=True, check=False)


def test_systemd_takes_it(tmp_path):
    file = tmp_path / "tokt.service"  # its program is not installed here
    text = SERVICE.read_text("utf-8")
    file.write_text(re.sub(r"^ExecStart=\S+", "ExecStart=/bin/true", text, flags=re.MULTILINE))
    done = analyze("verify", file)
    assert (done.returncode, done.stderr) == (0, "")


def test_it_is_exposed_to_little():
    done = analyze("security", "--offline=true", SERVICE)
    (level,) = re.findall(r"exposure level for tokt.service: ([\d.]+)", done.stdout)
    assert float(level) <= MAX_EXPOSURE
