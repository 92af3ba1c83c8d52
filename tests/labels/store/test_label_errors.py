"""A label store whose disk fails at any system call: what the command says is what is stored."""

import errno
import os
import shutil
import subprocess
import sys

import pytest

from tests.calls import answering, refused, succeeds
from tests.inference.test_faults import hold_row
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import FILE_NAME, LabelStore

# The n-th write, sync or cut of a file whose name has "labels.db" in it fails, once `fail_at` is
# called with n; `failed` says whether it came to that.
SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>
static int left, hit;
void fail_at(int n) { left = n; hit = 0; }
int failed(void) { return hit; }
static int fails(int fd) {
    char link[64], name[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, name, sizeof name - 1);
    if (n < 0 || left < 1) return 0;
    name[n] = 0;
    if (!strstr(name, "labels.db") || --left) return 0;
    errno = EIO;
    return hit = 1;
}
#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define WRITE(name) ssize_t name(int fd, const void *data, size_t n, off_t at) \
    { return fails(fd) ? -1 : REAL(name)(fd, data, n, at); }
WRITE(pwrite)
WRITE(pwrite64)
int fsync(int fd) { return fails(fd) ? -1 : REAL(fsync)(fd); }
int fdatasync(int fd) { return fails(fd) ? -1 : REAL(fdatasync)(fd); }
int ftruncate(int fd, off_t n) { return fails(fd) ? -1 : REAL(ftruncate)(fd, n); }
int ftruncate64(int fd, off_t n) { return fails(fd) ? -1 : REAL(ftruncate64)(fd, n); }
"""
HOST = """
import ctypes, os, sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from tokt.cli import main
from tokt.labels import labels  # what a child imports it imports each time
shim = ctypes.CDLL(sys.argv[1])
print("ready", flush=True)
for line in sys.stdin:
    child = os.fork()
    if not child:
        said = StringIO()
        sys.argv[1:] = ["labels", "import", sys.argv[2], "--workspace", sys.argv[3]]
        shim.fail_at(int(line))
        try:
            with redirect_stdout(said), redirect_stderr(said):
                main()
        except SystemExit as end:
            words = " ".join(said.getvalue().split())
            print(shim.failed(), end.code, words, flush=True)
        os._exit(0)
    os.waitpid(child, 0)
"""


def labels(who, first, last):
    patches = (("dive", "left", frame, Grid(), 0, 0) for frame in range(first, last))
    return [LabelRecord(*patch, "ocean", who, "2016-04-20T10:00:00Z") for patch in patches]


@pytest.fixture
def file(tmp_path):
    """A label store with ten labels."""
    with LabelStore(tmp_path / "w" / FILE_NAME) as store:
        store.add(labels("anna", 0, 10))
    return store.path


@pytest.fixture
def shim(tmp_path):
    if sys.platform != "linux" or not shutil.which("cc"):
        pytest.skip("needs Linux and a C compiler")
    (tmp_path / "shim.c").write_text(SHIM)
    library = tmp_path / "shim.so"
    command = ["cc", "-shared", "-fPIC", "-o", library, tmp_path / "shim.c", "-ldl"]
    subprocess.run(command, check=True, capture_output=True)
    return library


def test_an_import_whose_disk_fails(file, shim, tmp_path, monkeypatch):
    saved, csv = shutil.copy(file, tmp_path / "saved.db"), tmp_path / "new.csv"
    rows = "".join(f"dive,left,{frame},0,0,ocean\n" for frame in range(10, 400))
    csv.write_text(f"mission,camera,frame,row,col,label\n{rows}")
    monkeypatch.setenv("LD_PRELOAD", str(shim))
    ends = []
    with answering(HOST, shim, csv, file.parent) as ask:
        for at in range(1, 200):
            for one in file.parent.iterdir():
                one.unlink()
            shutil.copy(saved, file)
            failed, code, words = ask(at).split(" ", 2)
            with LabelStore(file) as store:
                stored = len(store.current()) - 10
            assert stored == (390 if code == "0" else 0), (at, words)
            if code != "0":
                assert "disk I/O error" in words and "Traceback" not in words
            ends.append((code, "nothing was stored" in words))
            if failed == "0":
                break
    assert code == "0" and {("0", False), ("2", True)} <= {*ends} and len(ends) > 6, ends
    hold_row(
        "the disk fails at any step of `tokt labels import`",
        "all is stored and code 0, or the line says that nothing was stored",
        "nothing",
    )


@pytest.mark.skipif(os.name == "nt", reason="syncs no folder")
def test_a_backup_that_a_power_cut_may_undo(file, tmp_path, monkeypatch):
    target, real = tmp_path / "stick" / "labels.db", os.fsync
    target.parent.mkdir()

    def fsync(handle):
        if os.path.samestat(os.fstat(handle), target.parent.stat()):
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    words = f"{target}: Input/output error as folder stick was synced; its new content is in place"
    refused(words, "labels", "backup", target, "--workspace", file.parent)
    with LabelStore(target, create=False) as store:
        assert len(store.current()) == 10
    monkeypatch.setattr(os, "fsync", real)
    succeeds("labels", "backup", tmp_path / "again.db", "--workspace", file.parent)
    hold_row(
        "a folder that cannot be synced after a file got its name: backup, export, calibration",
        "`its new content is in place, but a power cut may undo it`, code 2",
        "nothing",
    )


def test_words_where_the_file_may_only_be_read(file):
    with LabelStore(file) as store:
        store._connection.execute("PRAGMA query_only = TRUE")
        with pytest.raises(ToktError, match="readonly database; nothing was stored"):
            store.add(labels("anna", 10, 11))
        assert len(store.current()) == 10
