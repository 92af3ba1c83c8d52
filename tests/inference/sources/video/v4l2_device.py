"""A USB camera that a preloaded library stands in for; what it sends is a test's to say."""

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

WHOLE, DAMAGED, GONE, HANGS, NO_TIME = range(5)
FLAGS = ["-std=c11", "-D_GNU_SOURCE", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]


@pytest.fixture(scope="session")
def stand_in(tmp_path_factory):
    """The library that stands for a device."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("the stand-in needs a C compiler")
    library = tmp_path_factory.mktemp("v4l2") / "device.so"
    source = Path(__file__).parent / "v4l2_device.c"
    subprocess.run([compiler, *FLAGS, "-o", library, source, "-ldl"], check=True)
    return library


class Device:
    """A camera whose buffers a test writes."""

    def __init__(self, folder):
        self.folder, self.path = folder / "frames", folder / "video0"
        self.folder.mkdir()
        self.path.touch()

    def sends(self, name, *buffers):
        """In this format, again and again: each what becomes of it, and its bytes."""
        data = (struct.pack("=II", kind, len(data)) + data for kind, data in buffers)
        (self.folder / name).write_bytes(b"".join(data))

    def url(self, options=""):
        return f"v4l2:{self.path}{options}"


@pytest.fixture
def device(stand_in, tmp_path, monkeypatch):
    made = Device(tmp_path)
    monkeypatch.setenv("LD_PRELOAD", str(stand_in))
    monkeypatch.setenv("TOKT_V4L2_DEVICE", str(made.path))
    monkeypatch.setenv("TOKT_V4L2_FRAMES", str(made.folder))
    return made
