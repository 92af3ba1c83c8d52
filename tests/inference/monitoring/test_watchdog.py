"""The watchdog with real child processes, and the words it goes by with real sockets."""

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.waiting import MAX_S, until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.monitoring import watchdog
from tokt.inference.monitoring.watchdog import EVERY_S, Notifier, Watchdog

# What a runtime tells, without what makes it slow to start.
CHILD = """
import os, signal, sys, time
from pathlib import Path
from tokt.inference.monitoring.watchdog import _inherited
signs = _inherited(int(os.environ["TOKT_WATCHDOG"]))
tell = lambda words: os.write(signs, words.encode() + b"\\n")
with open(sys.argv[1], "a") as lives:
    lives.write(f"{os.getpid()} {os.environ['TOKT_RESTARTS']}\\n")
said, go_on = Path(sys.argv[1] + ".said"), Path(sys.argv[1] + ".go_on")
life = int(os.environ["TOKT_RESTARTS"])
"""
BEGINNING = b"what the run began with"
LOOP = "\nwhile True:\n    tell('WATCHDOG=1'); time.sleep(0.02)\n"


class Kept:
    """A watchdog in a thread, over a program; time passes only where a test says so."""

    def __init__(self, folder: Path, program: str, clock: Any) -> None:
        self.lives_file = folder / "lives"
        self.lives_file.touch()
        self.said, self.go_on = folder / "lives.said", folder / "lives.go_on"
        self.clock = clock
        self.lines: list[str] = []
        command = [sys.executable, "-c", CHILD + program, str(self.lives_file)]
        self.dog = Watchdog(
            command, self.lines.append, Notifier(clock, {}), beginning=lambda: BEGINNING
        )
        self.codes: list[int] = []
        self.thread = threading.Thread(
            target=lambda: self.codes.append(self.dog.run()), daemon=True
        )
        self.thread.start()

    def lives(self) -> list[tuple[int, int]]:
        """Process, and restarts so far, of each start."""
        rows = [line.split() for line in self.lives_file.read_text().splitlines()]
        return [(int(pid), int(restarts)) for pid, restarts in rows]

    def wait_for(self, lives: int) -> None:
        until(lambda: len(self.lives()) >= lives, lambda: self.lines)

    def wait_until_ready(self) -> None:
        until(lambda: self.dog._was_ready, lambda: self.lines)

    def pass_time(self, true: Callable[[], Any]) -> None:
        """Let time pass until something is true."""

        def passing() -> Any:
            self.clock.now += 0.25
            return true()

        until(passing, lambda: self.lines)

    def lose_patience(self) -> str:
        """Let time pass until the runtime's life has ended; what is said of it."""
        lines = len(self.lines)
        self.pass_time(lambda: len(self.lines) > lines)
        return self.lines[lines]

    def end(self) -> int:
        self.dog.stop()
        self.pass_time(lambda: not self.thread.is_alive())
        return self.codes[0]


@pytest.fixture
def keep(tmp_path, hand_clock, monkeypatch):
    monkeypatch.setattr(watchdog, "time", hand_clock)
    kept: list[Kept] = []

    def start(program: str) -> Kept:
        kept.append(Kept(tmp_path, program, hand_clock))
        return kept[-1]

    yield start
    for one in kept:
        one.end()


def test_a_runtime_that_is_killed_is_back_at_once(keep):
    kept = keep("tell('READY=1')" + LOOP)
    for life in (1, 2, 3):
        kept.wait_for(life)
        kept.wait_until_ready()
        psutil.Process(kept.lives()[-1][0]).kill()
        kept.wait_for(life + 1)
        assert bool(kept.clock.slept) == (life > 1)  # those that cannot stay up start more slowly
    assert [restarts for _, restarts in kept.lives()] == [0, 1, 2, 3]
    how = "signal 9" if os.name == "posix" else "exit code 15"
    assert f"{how}; started again (1)" in kept.lines[0]
    assert kept.end() == 0


def test_a_runtime_that_hangs_is_killed(keep):
    hangs = "signal.signal(signal.SIGTERM, signal.SIG_IGN)\ntell('READY=1')\n"
    kept = keep(f"{hangs}if life == 0: time.sleep(600)" + LOOP)
    kept.wait_until_ready()
    assert "does not answer and was killed" in kept.lose_patience()
    kept.wait_for(2)
    assert kept.end() == 0  # killed as well, as it does not listen
    assert not psutil.pid_exists(kept.lives()[-1][0])


def test_one_that_never_gets_ready_is_killed_too(keep):
    kept = keep("time.sleep(600)")
    kept.wait_for(1)
    assert "did not get ready" in kept.lose_patience()
    kept.wait_for(2)


BEHIND = "tell('hello'); tell('STOPPING=1')"
"""On a busy machine both wait to be read when the runtime has ended."""


@pytest.mark.parametrize(
    ("program", "code"), [("sys.exit(2)", 2), ("tell('STOPPING=1')", 0), (BEHIND, 0)]
)
def test_what_a_user_wrote_wrong_and_one_that_has_done_its_work_end_it(keep, program, code):
    kept = keep(program)
    kept.thread.join(MAX_S)
    assert kept.codes == [code] and len(kept.lives()) == 1


def test_one_that_ends_without_a_word_is_started_again(keep):
    """As it does on SIGTERM, which nobody but the watchdog may mean for good."""
    kept = keep("tell('READY=1')\nif life == 0: sys.exit(0)" + LOOP)
    kept.wait_for(2)
    assert "exit code 0; started again (1)" in kept.lines[0]
    assert kept.end() == 0


def test_the_same_code_after_it_has_worked_does_not(keep):
    waits = "while life == 0 and not go_on.exists(): time.sleep(0.002)\n"
    kept = keep(f"tell('READY=1')\n{waits}if life == 0: sys.exit(2)" + LOOP)
    kept.wait_until_ready()
    kept.go_on.touch()
    kept.wait_for(2)
    assert "exit code 2" in kept.lines[0]


def test_one_that_has_done_its_work_and_cannot_end_is_not_started_again(keep):
    kept = keep("tell('READY=1'); tell('STOPPING=1'); time.sleep(600)")
    until(lambda: kept.dog._finished)
    kept.pass_time(lambda: not kept.thread.is_alive())
    assert kept.codes == [0] and len(kept.lives()) == 1


def test_one_that_knows_no_sigterm_is_told_to_end(keep):
    """Windows has none: there it would kill, with a log half written."""
    kept = keep(
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\ntell('READY=1')\n"
        f"said.touch() if sys.stdin.buffer.read()[8:] == {BEGINNING!r} else None"
    )
    kept.wait_until_ready()
    kept.dog.stop()
    until(lambda: not kept.thread.is_alive())
    assert kept.codes == [0] and kept.said.exists() and not kept.lines


def test_what_the_one_before_said_is_no_sign_of_the_next(keep):
    """Even where a process that it left behind goes on in its name."""
    left = "import os, time; time.sleep(1); os.write({signs}, b'READY=1\\n'); open({said!r}, 'w')"
    begins = (
        "if life == 0:\n    import subprocess\n"
        f"    left = {left!r}.format(signs=signs, said=str(said))\n"
        "    subprocess.Popen([sys.executable, '-S', '-c', left], pass_fds=(signs,))\n"
        "    sys.exit(1)"
    )
    kept = keep(f"{begins}\ntime.sleep(600)")
    until(kept.said.exists)
    assert "did not get ready" in kept.lose_patience()
    assert "exit code 1" in kept.lines[0] and not kept.dog._was_ready
    kept.wait_for(3)


def test_each_start_is_given_what_the_run_began_with(keep):
    kept = keep(
        "given = sys.stdin.buffer.read(31)[8:]\nopen(f'{said}{life}', 'wb').write(given)\n"
        "if life == 0: sys.exit(1)\ntell('READY=1')" + LOOP
    )
    kept.wait_until_ready()
    given = [Path(f"{kept.said}{life}").read_bytes() for life in (0, 1)]
    assert given == [BEGINNING, BEGINNING]


def test_a_runtime_that_reads_nothing_holds_no_watchdog(tmp_path, hand_clock, monkeypatch, keep):
    """What it is to be given is more than a pipe takes."""
    monkeypatch.setitem(globals(), "BEGINNING", bytes(1_000_000))
    kept = keep("tell('READY=1')\nif life == 0: time.sleep(600)" + LOOP)
    kept.wait_until_ready()
    assert "does not answer and was killed" in kept.lose_patience()
    kept.wait_for(2)


@pytest.mark.skipif(os.name != "posix", reason="a script is a program on POSIX only")
def test_a_runtime_that_cannot_be_started_is_tried_again(tmp_path):
    program, lines = tmp_path / "tokt", []

    def say(line: str) -> None:
        lines.append(line)
        program.write_text("#!/bin/sh\nexit 2\n")
        program.chmod(0o700)

    assert Watchdog([str(program)], say, Notifier(SYSTEM_CLOCK, {})).run() == 2
    told = "the runtime cannot be started: No such file or directory; started again (1)"
    assert lines == [told]


def test_one_that_not_even_a_kill_ends_is_not_waited_for(monkeypatch, hand_clock):
    class Held(subprocess.Popen):
        """As one that the kernel holds."""

        def poll(self) -> None:
            hand_clock.now += watchdog.START_S

        def wait(self, timeout: float | None = None) -> int:
            assert timeout is not None, "it waits for ever"
            raise subprocess.TimeoutExpired("tokt", timeout)

    starts: list[subprocess.Popen[bytes]] = []
    real = subprocess.Popen

    def start(command: list[str], **more: Any) -> subprocess.Popen[bytes]:
        kind = real if starts else Held
        starts.append(kind([sys.executable, "-S", "-c", "raise SystemExit(2)"], **more))
        return starts[-1]

    monkeypatch.setattr(watchdog, "time", hand_clock)
    monkeypatch.setattr(watchdog.subprocess, "Popen", start)
    lines: list[str] = []
    assert Watchdog([], lines.append, Notifier(SYSTEM_CLOCK, {})).run() == 2
    assert lines == ["the runtime did not get ready and was killed; started again (1)"]
    real.wait(starts[0])


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="systemd's socket is a unix one")
@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_hears_the_words_of_sd_notify(tmp_path, hand_clock, abstract):
    if abstract and sys.platform != "linux":
        pytest.skip("only Linux has abstract names")
    name = f"@tokt-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + name[1:] if abstract else name)
        systemd.settimeout(MAX_S)
        notifier = Notifier(hand_clock, {"NOTIFY_SOCKET": name})
        notifier.ready()
        for _ in range(3):
            notifier.alive()
            hand_clock.now += 0.6 * EVERY_S
        notifier.stopping()
        heard = [systemd.recv(100) for _ in range(4)]
        assert heard == [b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1", b"STOPPING=1"]
    notifier.alive()  # systemd has gone; nothing happens
    notifier.close()


def test_without_anyone_to_tell_nothing_is_told(hand_clock):
    for environ in ({}, {"NOTIFY_SOCKET": "/nowhere/at/all"}, {"TOKT_WATCHDOG": "no pipe"}):
        notifier = Notifier(hand_clock, environ)
        notifier.ready()
        notifier.alive()
        notifier.close()


def test_a_runtime_knows_when_its_watchdog_ends_it_or_has_died(hand_clock):
    """Either way its standard input ends."""
    commands, watchdogs = os.pipe()
    signs, theirs = os.pipe()
    notifier = Notifier(hand_clock, {"TOKT_WATCHDOG": str(theirs)}, commands)
    os.write(watchdogs, b"what the run began with")
    notifier.ready()
    assert os.read(signs, 100) == b"READY=1\n"
    assert not notifier.dismissed
    os.close(watchdogs)
    until(lambda: notifier.dismissed)
    os.close(signs)
    notifier.stopping()  # nobody hears it
    notifier.close()
    os.close(commands)


def test_a_pipe_that_nobody_reads_holds_no_runtime(hand_clock):
    commands, watchdogs = os.pipe()
    signs, theirs = os.pipe()
    notifier = Notifier(hand_clock, {"TOKT_WATCHDOG": str(theirs)}, commands)
    for _ in range(20_000):  # more than the pipe takes
        notifier.ready()
    notifier.close()
    for end in (commands, watchdogs, signs):
        os.close(end)


def test_a_runtime_whose_watchdog_has_died_knows_it():
    """SIGKILL to the watchdog: the runtime that it started ends by itself."""
    runtime = """
import os, sys, time
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.monitoring.watchdog import Notifier
notifier = Notifier(SYSTEM_CLOCK)
notifier.ready()
print(os.getpid(), flush=True)
while not notifier.dismissed: time.sleep(0.01)
print("ended", flush=True)
"""
    program = f"""
import sys
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.monitoring.watchdog import Notifier, Watchdog
Watchdog([sys.executable, "-c", {runtime!r}], print, Notifier(SYSTEM_CLOCK, {{}})).run()
"""
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert parent.stdout is not None
    assert int(parent.stdout.readline()) != parent.pid
    parent.kill()
    assert parent.stdout.readline() == b"ended\n"
    parent.stdout.close()
    parent.wait()
