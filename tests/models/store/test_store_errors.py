"""A store's command whose n-th operation on a file fails, for each n: it says what the store shows.

Opening, writing, syncing, renaming, removing and making fail by turns: once (EIO), or from then on
(ENOSPC).
"""

import errno
import io
import os
import re
import shutil
import sys
from pathlib import Path

import pytest

from tests.calls import call_tokt, refuses
from tests.inference.test_faults import hold_row
from tokt.features.common import atomic
from tokt.models.store.last_good import remember_good

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads names in /proc")

CALLS = ("open", "fsync", "replace", "unlink", "mkdir")


class Disk:
    """The operations on files of a folder, the `at`-th of which fails, as those after it may."""

    def __init__(self, monkeypatch, folder):
        self.folder, self.count, self.at, self.code, self.on = str(folder), 0, 0, 0, False
        self.broken = ""
        for name in CALLS:
            monkeypatch.setattr(os, name, self._failing(name, getattr(os, name)))
        monkeypatch.setattr(io, "open", self._opened(io.open))
        monkeypatch.setattr("builtins.open", io.open)

    def fail(self, at, code, *, on):
        self.count, self.at, self.code, self.on, self.broken = 0, at, code, on, ""

    def _look(self, name, place):
        if isinstance(place, int):
            place = Path(f"/proc/self/fd/{place}").readlink()
        if self.at and str(place).startswith(self.folder):
            self.count += 1
            if self.count == self.at or (self.on and self.count > self.at):
                self.broken = self.broken or f"{name} {Path(place).name}"
                raise OSError(self.code, os.strerror(self.code), str(place))

    def _failing(self, name, call):
        def failing(place, *arguments, **options):
            changes = name != "open" or arguments[0] != os.O_RDONLY or Path(place).is_dir()
            if changes and not (name == "mkdir" and Path(place).is_dir()):
                self._look(name, place)
            return call(place, *arguments, **options)

        return failing

    def _opened(self, real):
        disk = self

        class Writer(io.FileIO):
            def write(self, data):
                disk._look("write", self.name)
                return super().write(data)

        def opened(file, mode="r", *arguments, **options):
            if mode not in ("wb", "ab", "r+b") or not str(file).startswith(disk.folder):
                return real(file, mode, *arguments, **options)
            raw = Writer(str(file), mode.replace("b", ""), opener=options.get("opener"))
            return io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)

        return opened


@pytest.fixture
def store(store, signed):
    """One that went from ``a/1`` to ``b/2``."""
    for name in "ab":
        store.deploy(signed[name])
    return store


@pytest.fixture
def public(key_files):
    return key_files["boat"].with_suffix(".pub")


@pytest.fixture
def disk(monkeypatch, store):
    return Disk(monkeypatch, store.path)


def each_failure(disk, store, *command):
    """Run a command with each of its operations failing, on a store as before; how each ended."""
    saved = store.path.with_name("saved")
    shutil.copytree(store.path, saved)
    for code in (errno.EIO, errno.ENOSPC):
        for at in range(1, 100):
            shutil.rmtree(store.path)
            shutil.copytree(saved, store.path)
            disk.fail(at, code, on=code == errno.ENOSPC)
            ran = call_tokt(*command)
            broken = disk.broken and f"{disk.broken}: {os.strerror(code)}"
            disk.fail(0, 0, on=False)
            yield broken, ran
            if not broken:
                break
        else:
            pytest.fail("it never ended by itself")


def active(store):
    """What the store shows, as another command would."""
    found = re.search(r"active: (\S+)", call_tokt("store", store.path).out)
    assert found and store.active().label == found[1]
    return found[1]


@pytest.mark.parametrize("name", ["deploy", "rollback", "deploy an old one"])
def test_what_is_active_is_said_after_each_error(name, store, disk, signed, tmp_path):
    new = {"deploy": "c/3", "rollback": "a/1", "deploy an old one": "a/1"}[name]
    file = tmp_path / "new.tokt"
    file.write_bytes(signed[new[0]].data)
    command = ("rollback", store.path) if name == "rollback" else ("deploy", file, store.path)
    told, ends = set(), set()
    for broken, ran in each_failure(disk, store, *command):
        said = " ".join((ran.out + ran.err).split())
        shown = active(store)
        assert ran.code == (0 if shown == new else 2), (broken, said)
        assert re.findall(r"(\S+) is active", said) == [shown], (broken, said)
        assert ("Traceback" not in said) and ran.err.count("\n") <= 5
        if ran.code == 0:
            # A full disk before `active` is replaced: the space that is kept for it was taken.
            assert (ran.err != "") == (broken != ""), (broken, ran)
            told.add(re.sub(r"partial-\w+-", "", broken))
        ends.add(ran.code)
    assert ends == {0, 2}
    assert "fsync store: Input/output error" in told and len(told) > 5, told
    hold_row(
        "the disk fails at any step of `tokt deploy` or `tokt rollback`",
        "before `active` is replaced: refused, and the line names what is active; after it: done, "
        "code 0, and a line for what failed",
        "nothing",
    )


def test_a_first_deployment_that_fails(store, disk, signed, tmp_path):
    shutil.rmtree(store.path)
    store.path.mkdir()
    file = tmp_path / "new.tokt"
    file.write_bytes(signed["a"].data)
    for broken, ran in each_failure(disk, store, "deploy", file, store.path):
        if store.active_entry() is None:
            assert ran.code == 2 and "; no model is active" in ran.err, (broken, ran)
        else:
            assert ran.code == 0 and ran.out.startswith(f"{store.path}: a/1 is active"), broken


def test_an_error_over_a_damaged_pointer(store, disk, signed):
    (store.path / "active").write_bytes(b"?")
    disk.fail(1, errno.ENOSPC, on=True)
    words = "No space left on device; what is active cannot be read$"
    refuses(words, store.deploy, signed["c"])
    disk.fail(0, 0, on=False)


@pytest.mark.parametrize("option", ["--trust", "--distrust", "--accept-unsigned"])
def test_whose_signatures_count_is_said_after_each_error(option, store, disk, keys, public):
    key = keys["boat"].public
    if option != "--trust":
        store.trust(key, "boat")
    more = {"--trust": [public], "--distrust": [key.id], "--accept-unsigned": []}[option]
    before, ends = store.trusted_keys().events, set()
    for broken, ran in each_failure(disk, store, "store", store.path, option, *more):
        changed = store.trusted_keys().events != before
        assert ran.code == (0 if changed else 2), (broken, ran)
        if changed:
            assert ran.out.count(option.strip("-").split("-")[0]) >= 1
        else:
            assert "; b/2 is active" in ran.err and ran.err.count("\n") == 1
        if changed and broken:
            assert "keys.json: " in ran.err and "a power cut may undo it" in ran.err, (broken, ran)
        ends.add(ran.code)
    assert ends == {0, 2}
    hold_row(
        "the disk fails at any step of a change to the keys of a store",
        "before the keys are replaced: refused; after it: done, code 0, and a line for what failed",
        "nothing",
    )


def test_the_last_good_copy_after_each_error(store, disk, signed):
    for at in range(1, 20):
        store.last_good_file.unlink(missing_ok=True)
        disk.fail(at, errno.EIO, on=False)
        words = remember_good(store, signed["b"])
        broken = disk.broken
        disk.fail(0, 0, on=False)
        kept = store.last_good_file.exists()
        assert kept == ("a power cut may undo it" in words or not words), (broken, words)
        assert kept or "no copy of b/2 is kept for the next start: Input/output error" in words
        if not broken:
            break
    assert at > 4 and not words


def test_a_file_in_place_whose_folder_cannot_be_synced(store, disk, tmp_path):
    target = store.path / "file"
    for at in range(1, 20):
        target.unlink(missing_ok=True)
        disk.fail(at, errno.EIO, on=True)
        try:
            atomic.write_bytes(target, b"new")
        except atomic.NotDurableError as error:
            assert target.read_bytes() == b"new" and error.errno == errno.EIO
        except OSError:
            assert not target.exists()
        else:
            break
        finally:
            disk.fail(0, 0, on=False)
    assert at == 7  # open, write, fsync, rename, open and fsync of the folder
