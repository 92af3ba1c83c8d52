"""A store whose command is killed before each of its file operations, or meets a full disk.

A host process forks a child for each trial. In the child an audit hook counts the operations on
files below the store that change anything (Python raises an event before it opens, renames, removes
or makes one) and ends the process, as SIGKILL would, when the chosen one is about to happen.
On Linux a small library (kill_at_call.c), loaded before libc, counts the calls of the system, too:
those that write, cut or sync a file as well.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.calls import answering, refuses
from tests.inference.test_faults import hold_row
from tokt.models.bundle.bundle import Bundle
from tokt.models.signing.keys import SigningKey
from tokt.models.store.health import store_summary
from tokt.models.store.last_good import load_running, remember_good
from tokt.models.store.store import Store

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs fork")

HOST = """
import ctypes, os, sys, json, resource
from pathlib import Path
import cv2
from tokt.models.bundle.bundle import read_bundle
from tokt.models.store.last_good import remember_good
from tokt.models.signing.keys import read_public_key
from tokt.models.store.store import Store

cv2.setNumThreads(1)
EVENTS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate"}
store = Store(sys.argv[1])
bundles = {name: read_bundle(Path(sys.argv[2]) / f"{name}.tokt") for name in ("a", "b", "c")}
key = read_public_key(Path(sys.argv[3]))
commands = {
    "deploy": lambda: store.deploy(bundles["c"], "again", notice=print),
    "deploy an old one": lambda: store.deploy(bundles["a"], notice=print),
    "rollback": lambda: store.rollback("bad", notice=print),
    "rollback to 1": lambda: store.rollback("worse", "1", notice=print),
    "trust": lambda: store.trust(key, "boat", notice=print),
    "distrust": lambda: store.distrust(key.id),
    "accept unsigned": lambda: store.accept_unsigned(notice=print),
    "remember": lambda: print(remember_good(store, bundles["b"])),
}

def kill_at(step):
    left = [step]
    def hook(event, arguments):
        if event == "open" and not arguments[2] & (os.O_WRONLY | os.O_RDWR):
            return
        if event in EVENTS and str(arguments[0]).startswith(sys.argv[1]):
            name = Path(arguments[0]).name
            if event == "open" and not name.startswith((".partial-", "lock", "history.jsonl")):
                os._exit(3)  # what is written in place can be found half-written
            left[0] -= 1
            if left[0] == 0:
                os._exit(9)
    sys.addaudithook(hook)

print("ready", flush=True)
for line in sys.stdin:
    name, step, limit, torn = json.loads(line)
    child = os.fork()
    if not child:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        code = 0
        try:
            if limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            if torn is None:
                kill_at(step)
            else:
                ctypes.CDLL(None).kill_at_call(step, torn)
            commands[name]()
        except BaseException as error:
            code = 2 if type(error).__name__ == "ToktError" else 1
        finally:
            os._exit(code)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""

SOURCE = Path(__file__).with_name("kill_at_call.c")
CC = shutil.which("cc") if sys.platform == "linux" else None
COMPILER = None if CC is None else [CC, "-shared", "-fPIC"]
Run = Callable[..., int]
COMMANDS = ["deploy", "rollback", "trust", "distrust", "accept unsigned"]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("interrupted")


@pytest.fixture(scope="module")
def run(place, signed, key_files):
    """Run a command in the store, killed at a step if one is given; gives the exit code."""
    for name, bundle in signed.items():
        (place / f"{name}.tokt").write_bytes(bundle.data)
    public = key_files["boat"].with_suffix(".pub")
    with pytest.MonkeyPatch.context() as patch:
        if COMPILER is not None:
            library = place / "kill_at_call.so"
            subprocess.run([*COMPILER, "-o", library, SOURCE, "-ldl"], check=True)
            patch.setenv("LD_PRELOAD", str(library))
        with answering(HOST, place / "store", place, public) as ask:
            yield lambda name, step=0, limit=None, torn=None: int(
                ask(json.dumps([name, step, limit, torn]))
            )


@pytest.fixture
def store(place, signed, keys):
    """A store that went from ``a/1`` to ``b/2``, which is running."""
    store = Store(place / "store")
    for name in "ab":
        store.deploy(signed[name])
    yield store
    shutil.rmtree(store.path)


def state(store: Store) -> tuple[Any, ...]:
    """What people decided: models and keys, without times."""
    entries = [(entry.number, entry.action, entry.label) for entry in store.history()]
    events = [event.action for event in store.trusted_keys().events]
    good = store.last_good_file.read_bytes() if store.last_good_file.exists() else b""
    return (entries, events, good)


def prepared(store: Store, keys: dict[str, SigningKey], signed: dict[str, Bundle], name: str):
    if name in ("distrust", "accept unsigned"):
        store.trust(keys["boat"].public, "boat")
    if name == "remember":
        remember_good(store, signed["a"])


MORE = ["deploy an old one", "rollback to 1", "remember"]
BY_CALL = pytest.mark.skipif(COMPILER is None, reason="needs Linux and a C compiler")
KILLED = {
    "before an operation": None,
    "before a call": pytest.param(0, marks=BY_CALL),
    "within a write": pytest.param(1, marks=BY_CALL),
}


@pytest.mark.parametrize("torn", KILLED.values(), ids=KILLED)
@pytest.mark.parametrize("name", [*COMMANDS, *MORE])
def test_killed_at_every_step(store, keys, signed, run, place, name, torn):
    if name == "rollback to 1":
        store.deploy(signed["c"])
    prepared(store, keys, signed, name)
    saved = place / "saved"
    shutil.copytree(store.path, saved)
    before = state(store)
    assert run(name) == 0
    after = state(store)
    assert after != before
    seen = set()
    for step in range(1, 60):
        shutil.rmtree(store.path)
        shutil.copytree(saved, store.path)
        code = run(name, step, torn=torn)
        if code == 0:
            break
        assert code == (9 if torn is None else -signal.SIGKILL)
        found = state(store)
        assert found in (before, after), step
        seen.add(found == after)
        if name != "distrust" or found == before:
            bundle, notes = load_running(store)
            assert (bundle.sha256, notes) == (store.history()[-1].sha256, [])
        if found == before and step % 3 == 1:
            assert run(name) == 0, "it can be repeated"
            assert state(store) == after
        elif name != "distrust":
            assert run("deploy") == 0, "the next one works"
            assert load_running(store)[0].label == "c/3"
    else:
        pytest.fail("it never ended by itself")
    shutil.rmtree(saved)
    assert step > (1 if torn else 3) and False in seen
    hold_row(
        "a command on the store is killed at any instant, or at any of its system calls",
        "the store is as before it or as after it, and its active model runs; the next works",
        "nothing",
    )


@pytest.mark.parametrize("torn", KILLED.values(), ids=KILLED)
def test_killed_during_the_very_first_deployment(store, run, torn):
    for step in range(1, 60):
        shutil.rmtree(store.path)
        code = run("deploy", step, torn=torn)
        if code == 0:
            break
        if store.path.is_dir() and store.active_entry() is not None:
            assert store.active().label == load_running(store)[0].label == "c/3"
        else:
            refuses(r"no active model|does not exist", load_running, store)
        assert run("deploy") == 0
        assert store.active().label == "c/3"
    assert code == 0 and step > (3 if torn else 8)


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("limit", [0, 100, 340])
def test_a_full_disk(store, keys, signed, run, name, limit):
    """The system refuses every write beyond so many bytes of a file."""
    prepared(store, keys, signed, name)
    before = state(store)
    code = run(name, limit=limit)
    assert code in (0, 2)
    found = state(store)
    assert (found != before) == (code == 0)
    assert not list(store.path.rglob(".partial-*"))
    if name != "distrust":
        assert store.active().sha256 == store.history()[-1].sha256
    if code == 2:
        assert run(name) == 0


def test_reading_writes_nothing(store, signed):
    """Neither a file nor a time stamp: a runtime works from a folder it may only read."""
    remember_good(store, signed["b"])

    def all_files() -> dict[Path, tuple[int, int]]:
        found = {path: path.stat() for path in [store.path, *store.path.rglob("*")]}
        return {path: (stat.st_mtime_ns, stat.st_ino) for path, stat in found.items()}

    before = all_files()
    store.active()
    load_running(store)
    store.history()
    store_summary(store)
    store.bundle_file(signed["b"].sha256).write_bytes(b"damaged")
    before = all_files()
    assert load_running(store)[0].label == "b/2"
    store_summary(store)
    refuses("no entry", store.rollback, to="9")
    assert all_files() == before


@pytest.mark.skipif(os.geteuid() != 0 if os.name != "nt" else True, reason="needs to be root")
def test_a_read_only_file_system(store, signed, keys, tmp_path):
    """What the runtime needs works; whatever writes says so in one line."""
    script = (
        "import sys; from pathlib import Path\n"
        "from tokt.features.common.errors import ToktError\n"
        "from tokt.models.bundle.bundle import read_bundle\n"
        "from tokt.models.store.last_good import load_running, remember_good\n"
        "from tokt.models.store.store import Store\n"
        "store, bundle = Store(sys.argv[1]), read_bundle(sys.argv[2])\n"
        "print(load_running(store)[0].label)\n"
        "print(remember_good(store, bundle))\n"
        "for act in (lambda: store.deploy(bundle), store.rollback, store.accept_unsigned):\n"
        "    try:\n"
        "        act()\n"
        "    except ToktError as error:\n"
        "        print(error)\n"
    )
    (tmp_path / "c.tokt").write_bytes(signed["c"].data)
    shell = 'mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" && shift && exec "$@"'
    mount = ["unshare", "-m", "sh", "-c", shell, "sh", store.path]
    python = [sys.executable, "-c", script, store.path, tmp_path / "c.tokt"]
    done = subprocess.run([*mount, *python], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()[-80:]}")
    lines = done.stdout.splitlines()
    assert lines[0] == "b/2" and len(lines) == 5
    assert all("Read-only file system" in line for line in lines[1:]), done.stdout
    hold_row(
        "a store that may only be read",
        "its active model runs, and no copy is kept; a command says so and changes nothing",
        "nothing",
    )
