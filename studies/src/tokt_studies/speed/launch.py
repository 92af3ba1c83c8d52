"""Start a program and say when it was started and how much memory it took at its peak.

Run as ``python -I -S launch.py PROGRAM ARGUMENT...``. It stands between the measuring process and
the measured one because Linux counts the memory of the process that starts a program towards the
program's peak, and this one is small. The last line on standard output is JSON.
"""

import json
import os
import subprocess
import sys
import time


def launch(command: list[str]) -> dict[str, object]:
    """Run a command to its end.

    Gives ``started``: `time.monotonic` before the start; ``code``: its exit code; ``peak_mb``: peak
    resident memory in MB (10**6 bytes), None where the system does not tell; ``error``: the last
    line it wrote on standard error.
    """
    started = time.monotonic()
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    errors = b"" if child.stderr is None else child.stderr.read()
    peak_mb = None
    if hasattr(os, "wait4"):
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        # Bytes on macOS, units of 1024 bytes elsewhere (getrusage(2)).
        peak_mb = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e6
    code = child.wait()
    last = (errors.decode("utf-8", "replace").strip().splitlines() or [""])[-1]
    return {"started": started, "code": code, "peak_mb": peak_mb, "error": last}


if __name__ == "__main__":
    print(json.dumps(launch(sys.argv[1:])))
