"""The real pymba on a simulated Vimba library, which is compiled from `vimba_simulator`."""

import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.report import Event
from tokt.inference.sources.cameras.capture import CameraDriver
from tokt.inference.sources.cameras.live_source import CameraSource
from tokt.inference.sources.open import open_camera_source

from .simulated_rig import FOLDERS, Delivered, Live, Simulator

SOURCES = Path(__file__).parent / "vimba_simulator"
FLAGS = ["-std=c11", "-D_GNU_SOURCE", "-O0", "-Wall", "-Wextra", "-Werror"]
SHARED = ["-fvisibility=hidden", "-shared", "-fPIC", "-pthread"]


@pytest.fixture(scope="session")
def compiler():
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None or platform.machine() not in FOLDERS or sys.platform != "linux":
        pytest.skip("the simulated Vimba library needs a C compiler, on Linux")
    return found


@pytest.fixture(scope="session")
def vimba_environment(compiler, tmp_path_factory):
    """What a process needs in its environment for pymba to load the simulated library."""
    root = tmp_path_factory.mktemp("vimba")
    library = root / "VimbaC" / "DynamicLib" / FOLDERS[platform.machine()] / "libVimbaC.so"
    library.parent.mkdir(parents=True)
    sources = sorted(map(str, SOURCES.glob("*.c")))
    subprocess.run([compiler, *FLAGS, *SHARED, "-o", library, *sources, "-lm"], check=True)
    # The SDK's own layout: pymba goes three folders up from here.
    cti = root / "VimbaGigETL" / "CTI" / FOLDERS[platform.machine()]
    return {"GENICAM_GENTL64_PATH": str(cti), "TOKT_TEST_VIMBA": str(library)}


@pytest.fixture(scope="module")
def vimba_library(vimba_environment):
    """pymba imported into this process, and out of it again: other tests have no SDK."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in vimba_environment.items():
            patch.setenv(name, value)
        import pymba  # noqa: F401
    yield Simulator(vimba_environment["TOKT_TEST_VIMBA"])
    for name in [name for name in sys.modules if name.partition(".")[0] == "pymba"]:
        del sys.modules[name]


@pytest.fixture
def simulator(vimba_library):
    """Two cameras as they are after switching on."""
    vimba_library.reset()
    yield vimba_library
    assert vimba_library.opened == [0, 0]


@pytest.fixture
def delivered():
    return Delivered()


@pytest.fixture
def made_drivers():
    """A list of drivers that are stopped at the end, whatever happens."""
    drivers: list[CameraDriver] = []
    yield drivers
    for driver in drivers:
        driver.stop()


@pytest.fixture
def live(simulator):
    """Open cameras by the text a user gives, in Mono8 unless told otherwise."""
    opened: list[CameraSource] = []

    def make(text: str = "pymba:0,1", **options: object) -> Live:
        chosen = SourceConfig(text, **{"pixel_format": "Mono8", **options})  # type: ignore[arg-type]
        events: list[Event] = []
        source = open_camera_source(chosen, SYSTEM_CLOCK, events.append)
        opened.append(source)
        return Live(source, events)

    yield make
    for source in opened:
        source.close()
