"""A UDP socket in a process of its own that notes when each datagram was there.

Run as ``python -m tokt_studies.speed.stamped_receiver``. The port is the first line on standard
output; when standard input ends, the rest is a JSON list of ``[seconds, datagram]``. The seconds
are of `time.monotonic`, which all processes of a machine read alike (on Linux, macOS and Windows).
"""

import json
import socket
import subprocess
import sys
import threading
import time

from tokt.features.common.errors import ToktError

_MAX_DATAGRAM = 65535
_BUFFER_BYTES = 1 << 20
_WAIT_S = 0.2


class StampedReceiver:
    """The process, for who measures, on a `port` of 127.0.0.1.

    Raises ToktError if it cannot be started.
    """

    def __init__(self) -> None:
        pipe = subprocess.PIPE
        command = [sys.executable, "-m", __name__]
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        assert self._process.stdout is not None, "it is a pipe"
        line = self._process.stdout.readline()
        if not line.strip().isdigit():
            raise ToktError("a receiver of datagrams cannot be started")
        self.port = int(line)

    def heard(self) -> list[tuple[float, bytes]]:
        """End it; when each datagram was there, and its bytes, in order."""
        said, _ = self._process.communicate("")
        return [(at, data.encode("ascii")) for at, data in json.loads(said)]

    def close(self) -> None:
        """End it, whatever it has heard."""
        with self._process:  # which closes its pipes and waits for it
            self._process.kill()


def main() -> None:
    """Run as the program."""
    ended = threading.Event()
    heard: list[tuple[float, str]] = []

    def wait_for_the_end() -> None:
        sys.stdin.read()
        ended.set()

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(_WAIT_S)
        print(opened.getsockname()[1], flush=True)
        threading.Thread(target=wait_for_the_end, daemon=True).start()
        while True:
            try:
                data = opened.recv(_MAX_DATAGRAM)
            except TimeoutError:
                if ended.is_set():
                    break
                continue
            heard.append((time.monotonic(), data.decode("ascii")))
    print(json.dumps(heard))


if __name__ == "__main__":
    main()
