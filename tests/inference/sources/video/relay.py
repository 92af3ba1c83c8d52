"""A bad network on the loopback: datagrams and RTSP sessions that go through it suffer."""

import re
import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from .network import Network
from .senders import free_port

_LOOK_S = 0.05
_CLIENT_PORTS = re.compile(rb"client_port=(\d+)-(\d+)")


@contextmanager
def _thread(work: Callable[[threading.Event], None]) -> Iterator[None]:
    ended = threading.Event()
    thread = threading.Thread(target=work, args=(ended,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _udp(port: int = 0) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    opened.bind(("127.0.0.1", port))
    return opened


@contextmanager
def udp_relay(network: Network, to_port: int, port: int = 0) -> Iterator[int]:
    """Pass on what comes to a port of the loopback; yields that port, which senders send to."""
    with _udp(port) as inlet, _udp() as outlet:

        def work(ended: threading.Event) -> None:
            while not ended.is_set():
                if select.select([inlet], [], [], _LOOK_S)[0]:
                    for data in network.pass_on(inlet.recv(1 << 16)):
                        with suppress(OSError):  # nobody listens yet
                            outlet.sendto(data, ("127.0.0.1", to_port))

        with _thread(work):
            yield int(inlet.getsockname()[1])


@contextmanager
def rtsp_relay(network: Network, url: str) -> Iterator[str]:
    """An RTSP server's sessions, their RTP over UDP through a bad network; yields the URL to use.

    RTCP passes whole, and so does all of a session over TCP.
    """
    found = re.fullmatch(r"(rtsp://(?:[^@/]*@)?)127\.0\.0\.1:(\d+)(/.*)", url)
    assert found, url
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def work(ended: threading.Event) -> None:
            listening.settimeout(_LOOK_S)
            sessions = []
            while not ended.is_set():
                with suppress(TimeoutError):
                    client, _ = listening.accept()
                    arguments = network, client, int(found[2]), ended
                    sessions.append(threading.Thread(target=_session, args=arguments))
                    sessions[-1].start()
            for session in sessions:
                session.join()

        with _thread(work):
            yield f"{found[1]}127.0.0.1:{listening.getsockname()[1]}{found[3]}"


def _session(network: Network, client: socket.socket, port: int, ended: threading.Event) -> None:
    """One client's; its two ports are exchanged for the relay's in what it asks, and back."""
    own = free_port()
    theirs: tuple[bytes, bytes] | None = None
    with (
        suppress(OSError),
        client,
        socket.create_connection(("127.0.0.1", port)) as server,
        _udp(own) as media,
        _udp(own + 1) as control,
        _udp() as outlet,
    ):
        ours = b"client_port=%d-%d" % (own, own + 1)
        while not ended.is_set():
            for ready in select.select([client, server, media, control], [], [], _LOOK_S)[0]:
                data = ready.recv(1 << 16)
                if ready is client:
                    if asked := _CLIENT_PORTS.search(data):
                        theirs = asked[1], asked[2]
                    server.sendall(_CLIENT_PORTS.sub(ours, data))
                elif ready is server:
                    if theirs:
                        data = data.replace(ours, b"client_port=%b-%b" % theirs)
                    client.sendall(data)
                elif theirs:
                    out = network.pass_on(data) if ready is media else [data]
                    for each in out:
                        outlet.sendto(each, ("127.0.0.1", int(theirs[ready is control])))
                if ready in (client, server) and not data:
                    return
