"""Windows, as far as another system can show it: nothing that it lacks is used at import.

A child process takes away the modules and functions that Python has on POSIX alone. It shows
nothing of how Windows behaves.
"""

import json
from pathlib import Path

from tests.calls import run_python

ROOT = Path(__file__).resolve().parents[1]
FAKE = """
import json, os, select, signal, socket, sys, time
import asyncio, concurrent.futures.process, ctypes, multiprocessing.shared_memory
import multiprocessing.connection
import cv2, numpy, rich.console, rich.progress, tokt, typer  # others' have seen the real system
MODULES = ("fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty")
FUNCTIONS = {
    os: "fork forkpty getuid geteuid getgid setsid killpg mkfifo nice setpriority uname "
    "sched_getaffinity sched_setaffinity set_blocking fchmod chown statvfs WNOHANG O_NONBLOCK",
    signal: "SIGKILL SIGHUP SIGUSR1 SIGUSR2 SIGALRM SIGTTOU SIGPIPE SIGSTOP SIGCONT SIGCHLD alarm "
    "setitimer pthread_sigmask sigwait",
    socket: "AF_UNIX AF_NETLINK MSG_DONTWAIT SO_REUSEPORT CMSG_SPACE",
    select: "epoll poll",
    time: "clock_gettime CLOCK_BOOTTIME CLOCK_MONOTONIC tzset",
}
for name in MODULES:
    sys.modules[name] = None
for module, names in FUNCTIONS.items():
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
sys.platform = "win32"
import types
sys.modules["msvcrt"] = types.SimpleNamespace(LK_NBLCK=2, LK_UNLCK=0, locking=lambda *_: None)
failed = {}
for name in json.loads(sys.argv[1]):
    try:
        __import__(name)
    except BaseException as error:
        failed[name] = f"{type(error).__name__}: {error}"
print(json.dumps(failed))
"""


def runtime_modules():
    """All modules of what a ship runs, but drivers and servers of the extras."""
    for folder in ("features", "models", "inference", "cli"):
        for path in sorted((ROOT / "src/tokt" / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / "src").with_suffix("").parts
            yield ".".join(parts).removesuffix(".__init__")


def test_nothing_that_windows_lacks_is_used_at_import():
    """Registry and library kernels import tools that have seen another system."""
    left_out = ("tokt.models.registry", "tokt.features.kernels.reference")
    names = [name for name in runtime_modules() if not name.startswith(left_out)]
    assert len(names) > 150
    ran = run_python("-c", FAKE, json.dumps(names))
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout) == {}
