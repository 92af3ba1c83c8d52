"""Without the Vimba SDK, or without pymba: one line that says what to install and set."""

import platform
import sys
from pathlib import Path

import pytest

from tests.calls import refuses
from tokt.inference.sources.cameras.vimba.system import camera_driver_finding, load_pymba

from .simulated_rig import FOLDERS

needs_like = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() not in FOLDERS,
    reason="pymba looks for its library in another way here",
)


def refusal() -> str:
    return refuses("", load_pymba)


def library_of(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(folder / "Tl" / "CTI" / "x86_64bit"))
    library = folder / "VimbaC" / "DynamicLib" / FOLDERS[platform.machine()] / "libVimbaC.so"
    library.parent.mkdir(parents=True)
    return library


@needs_like
def test_no_sdk_says_what_to_install_and_set(monkeypatch, tmp_path):
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    words = refusal()  # an AssertionError of pymba's
    assert "Vimba SDK" in words and "GENICAM_GENTL64_PATH" in words and "VIMBA_HOME" in words
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(tmp_path / "Tl" / "CTI" / "x86_64bit"))
    words = refusal()  # an OSError of pymba's
    assert "No libVimbaC.so found" in words and "Vimba SDK" in words
    # `tokt doctor` says the same.
    finding = camera_driver_finding()
    assert finding.state == "note"
    assert finding.text.partition("): ")[2] == words.partition("): ")[2] != ""


@needs_like
def test_a_library_that_does_not_load(monkeypatch, tmp_path):
    library_of(tmp_path, monkeypatch).write_text("not a library")
    words = refusal()
    assert "cannot load the Vimba library" in words and "libVimbaC.so" in words


def test_no_pymba_names_the_extra(monkeypatch):
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if "site-packages" not in entry])
    assert refusal() == "no pymba; live cameras need the extra 'camera'"


def test_doctor_and_the_simulator_in_another_process(vimba_environment, monkeypatch):
    """pymba's 41 symbols are there: it is imported."""
    for name, value in vimba_environment.items():
        monkeypatch.setenv(name, value)
    finding = camera_driver_finding()
    assert finding.state == "ok" and "VimbaC 1.8.3" in finding.text
