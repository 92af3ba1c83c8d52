"""Links over real sockets and a pseudo-terminal: nobody waits, and what breaks is opened again."""

import math
import os
import select
import shutil
import socket
import struct
import subprocess
import sys
import threading
from contextlib import ExitStack, contextmanager

import pytest

from tests.calls import refuses
from tests.inference.live import bound_socket
from tests.waiting import MAX_S, until
from tokt.inference.links import datagrams
from tokt.inference.links import link as streams
from tokt.inference.links.datagrams import NOBODY, OTHER, OWN, PLACES
from tokt.inference.links.link import open_link


class Heard:
    """What a link passes on."""

    def __init__(self):
        self.data = b""

    def __call__(self, data, sender):
        self.data += data
        return OWN if data.startswith(b"own") else OTHER if data.startswith(b"hello") else NOBODY


@contextmanager
def opened(text):
    link = open_link(text)
    heard = Heard()
    link.listen(heard)
    try:
        yield link, heard
    finally:
        link.close()


@pytest.fixture
def soon(monkeypatch):
    """A link that is tried again at once."""
    monkeypatch.setattr(streams, "FIRST_WAIT_S", 0.02)
    monkeypatch.setattr(streams, "MAX_WAIT_S", 0.05)


@pytest.fixture
def server():
    """A TCP port that somebody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(MAX_S)
        yield listening


def address_of(listening):
    return f"tcp:127.0.0.1:{listening.getsockname()[1]}"


def accepted(listening):
    channel, _ = listening.accept()
    channel.settimeout(MAX_S)
    return channel


def received(channel, wanted):
    """What comes, until it holds what is wanted."""
    data = b""
    while wanted not in data:
        piece = channel.recv(4096)
        assert piece, data
        data += piece
    return data


def write_until(link, data, true):
    """Write again and again until something is true."""

    def again():
        link.write(data)
        return true()

    until(again, lambda: link.last_error)


def test_what_is_a_link(closed_port):
    for text in (
        *("192.168.2.2:14550", "udpout:here", "tcp:1.2.3.4", "udp:14550", "", "serial:", "ttyUSB0"),
        *("COM", "serial:/dev/ttyUSB0:x", "/dev/ttyUSB0:115200:8"),
    ):
        refuses("", open_link, text)
    refuses("baud", open_link, "COM3:1")
    refuses("address to listen on", open_link, "udpout:0.0.0.0:14550")
    with bound_socket() as taken:
        refuses("cannot listen on", open_link, f"udpin:127.0.0.1:{taken.getsockname()[1]}")
    for text in (
        *(f" udpin:127.0.0.1:{closed_port} ", "udpout:[::1]:9", f"tcp:127.0.0.1:{closed_port}"),
        *("/dev/ttyUSB0", "serial:/dev/ttyACM0:115200", "COM3:57600", "serial:COM3"),
        "/dev/serial/by-path/pci-0000:00:14.0-usb-0:3:1.0-port0:57600",
    ):
        with opened(text):
            pass


def test_udpin_answers_whom_it_has_heard(closed_port, monkeypatch):
    here = ("127.0.0.1", closed_port)
    with opened(f"udpin:127.0.0.1:{closed_port}") as (link, heard), bound_socket() as one:
        link.write(b"nobody")
        assert (link.sent, link.failed, link.last_error) == (0, 1, "nobody is heard there")
        one.sendto(b"rubbish", here)  # nothing that was understood
        until(lambda: heard.data == b"rubbish")
        link.write(b"nobody")
        assert (link.sent, link.gaps) == (0, 0)
        with bound_socket() as other:
            one.sendto(b"hello", here)
            other.sendto(b"hello", here)
            until(lambda: link.gaps == 2)
            link.write(b"verdict")
            assert one.recv(100) == other.recv(100) == b"verdict"
            assert link.sent == 1
        monkeypatch.setattr(datagrams, "PEER_S", -1.0)
        link.write(b"gone")
        assert (link.sent, link.failed) == (1, 3)


def test_udpin_answers_a_few_and_nobody_puts_them_out(closed_port):
    here = ("127.0.0.1", closed_port)
    peers = [bound_socket() for _ in range(PLACES[OTHER])]
    with opened(f"udpin:127.0.0.1:{closed_port}") as (link, heard):
        for number, peer in enumerate(peers, 1):
            peer.sendto(b"hello", here)
            until(lambda number=number: link.gaps == number)
        for _ in range(20):
            with bound_socket() as late:
                late.sendto(b"hello late", here)
        until(lambda: heard.data.count(b"late") == 20)
        link.write(b"verdict")
        assert [peer.recv(100) for peer in peers] == [b"verdict"] * PLACES[OTHER]
        assert link.gaps == len(link._peers) == PLACES[OTHER]
        assert link.full == {OTHER}
    for peer in peers:
        peer.close()


def test_udpin_always_has_a_place_for_its_own_system(closed_port, monkeypatch):
    """Behind a router other systems speak by its socket, too, and it has one place."""
    monkeypatch.setattr(datagrams, "PEER_S", math.inf)
    here = ("127.0.0.1", closed_port)
    with opened(f"udpin:127.0.0.1:{closed_port}") as (link, _), ExitStack() as sockets:
        peers = [sockets.enter_context(bound_socket()) for _ in range(PLACES[OTHER] + 1)]
        for number, (peer, said) in enumerate(zip(peers, [*[b"hello"] * 8, b"own"], strict=True)):
            peer.sendto(said, here)
            until(lambda number=number: link.gaps == number + 1)
        for said in (b"own", b"hello", b"rubbish"):
            peers[0].sendto(said, here)
        until(lambda: [kind for kind, _ in link._peers.values()].count(OWN) == 2)
        link.write(b"verdict")
        assert [peer.recv(100) for peer in peers] == [b"verdict"] * len(peers)
        assert link.gaps == len(peers) and OWN not in link.full
        peers[0].settimeout(0.05)
        with pytest.raises(TimeoutError):  # once is enough
            peers[0].recv(100)


def test_of_too_many_with_its_own_system_s_number_those_heard_last_are_answered(
    closed_port, monkeypatch
):
    monkeypatch.setattr(datagrams, "PEER_S", math.inf)
    here = ("127.0.0.1", closed_port)
    with opened(f"udpin:127.0.0.1:{closed_port}") as (link, _), ExitStack() as sockets:
        peers = [sockets.enter_context(bound_socket()) for _ in range(PLACES[OWN] + 3)]
        for number, peer in enumerate(peers, 1):
            peers[0].sendto(b"own", here)  # speaks more often than all others
            peer.sendto(b"own", here)
            until(lambda number=number: link.gaps == number)
        assert link.full == {OWN}
        link.write(b"verdict")
        silent = []
        for number, peer in enumerate(peers):
            peer.settimeout(0.05 if 1 <= number <= 3 else MAX_S)
            try:
                peer.recv(100)
            except TimeoutError:
                silent.append(number)
        assert silent == [1, 2, 3]


def test_tcp_goes_both_ways_and_sends_what_waits_at_its_end(server):
    with opened(address_of(server)) as (link, heard):
        with accepted(server) as channel:
            until(lambda: link.gaps == 1)
            channel.sendall(b"hello")
            until(lambda: heard.data == b"hello")
            for number in range(5):
                link.write(b"%d;" % number)
            link.close()
            assert received(channel, b"4;") == b"0;1;2;3;4;"
        assert (link.sent, link.failed) == (5, 0)


def test_tcp_that_is_refused_or_goes_away_is_opened_again(server, soon):
    name, port = address_of(server), server.getsockname()[1]
    server.close()
    with opened(name) as (link, _):
        write_until(link, b"lost", lambda: "refused" in link.last_error)
        assert link.sent == 0 and link.failed > 0
        for again in range(3):
            with socket.create_server(("127.0.0.1", port)) as back:
                back.settimeout(MAX_S)
                with accepted(back) as channel:
                    until(lambda again=again: link.gaps == again + 1)
                    link.write(b"found")
                    # Nothing that was written while nobody was there comes later.
                    assert received(channel, b"found") == b"found"
                    # Closed without what TCP waits for after an end, so that the port is free.
                    channel.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            write_until(link, b"lost", lambda: link._channel is None)


def test_a_stalled_end_is_left_for_a_new_connection(server, soon, monkeypatch):
    monkeypatch.setattr(streams, "STALL_S", 0.3)
    with opened(address_of(server)) as (link, _), accepted(server) as stalled:
        until(lambda: link.gaps == 1)
        write_until(link, bytes(1000), lambda: select.select([server], [], [], 0)[0])
        assert link.last_error == "the other end does not read" and link.failed
        with pytest.raises(ConnectionResetError):  # and not the rest, which is old
            while stalled.recv(4096):
                pass
        with accepted(server) as channel:
            write_until(link, b"new", lambda: select.select([channel], [], [], 0)[0])
            received(channel, b"new")


def test_what_waits_for_a_broken_connection_is_not_sent_by_the_next(server, soon, monkeypatch):
    monkeypatch.setattr(streams, "STALL_S", MAX_S)
    with opened(address_of(server)) as (link, _):
        with accepted(server) as channel:
            until(lambda: link.gaps == 1)
            write_until(link, bytes(1000), lambda: len(link._waiting) == streams.MAX_WAITING)
            channel.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        with accepted(server) as channel:
            until(lambda: link._channel is not None)
            assert link.failed >= streams.MAX_WAITING
            link.write(b"new")
            assert received(channel, b"new") == b"new"


def test_a_writer_does_not_wait_for_an_end_that_does_not_read(server):
    with opened(address_of(server)) as (link, _), accepted(server):
        until(lambda: link.gaps == 1)
        done = threading.Event()

        def write():
            for _ in range(5000):
                link.write(bytes(1000))
            done.set()

        # The other end reads nothing until all is written: whoever waited for it waits for ever.
        thread = threading.Thread(target=write, daemon=True)
        thread.start()
        assert done.wait(MAX_S)
        assert link.failed > 0 and len(link._waiting) <= streams.MAX_WAITING


CABLE_OUT = """
import socket, subprocess, sys, time
from tests.waiting import MAX_S, until
from tokt.inference.links.link import open_link

def cable(state):
    subprocess.run(["ip", "link", "set", "lo", state], check=True)

cable("up")
with socket.create_server(("127.0.0.1", 0)) as server:
    link = open_link(f"tcp:127.0.0.1:{server.getsockname()[1]}")
    link.listen(lambda data, sender: 1)
    other_end, _ = server.accept()
    until(lambda: link.gaps)
    cable("down")
    until(lambda: link._channel is None)
    print("noticed")
"""


@pytest.mark.process
def test_a_cable_that_is_out_is_noticed_by_who_only_reads():
    """In a network of its own, where there is such a thing."""
    alone = ["unshare", "--map-root-user", "--net"]
    if not shutil.which("ip") or subprocess.run([*alone, "true"], check=False).returncode:
        pytest.skip("no network namespaces")
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join(["", *sys.path])}
    command, told = [*alone, sys.executable, "-c", CABLE_OUT], {"capture_output": True}
    done = subprocess.run(command, **told, env=paths, text=True, check=False)
    assert done.stdout == "noticed\n", done.stderr


@pytest.fixture
def terminal():
    """A serial port: the other end's file descriptor, and the device."""
    ours, theirs = os.openpty()
    yield ours, os.ttyname(theirs)
    os.close(theirs)


def test_a_serial_port_goes_both_ways_and_comes_back(terminal, tmp_path, monkeypatch):
    ours, device = terminal
    port = tmp_path / "ttyUSB0"
    with opened(f"serial:{port}:57600") as (link, heard):
        write_until(link, b"lost", lambda: "could not open" in link.last_error)
        port.symlink_to(device)
        until(lambda: link.gaps == 1)
        os.write(ours, b"hello")
        until(lambda: heard.data == b"hello")
        link.write(b"verdict")
        assert os.read(ours, 100) == b"verdict"
        os.close(ours)  # unplugged
        port.unlink()
        write_until(link, b"lost", lambda: link._channel is None)
        ours, theirs = os.openpty()
        port.symlink_to(os.ttyname(theirs))
        until(lambda: link.gaps == 2)
        link.write(b"back")
        assert os.read(ours, 100) == b"back"
    os.close(ours)
    os.close(theirs)


def test_a_baud_rate_that_the_port_does_not_have(monkeypatch):
    serial = pytest.importorskip("serial")

    def refuse(*_, **__):
        raise ValueError("no such rate")

    monkeypatch.setattr(serial, "Serial", refuse)
    with opened("COM3:12345") as (link, _):
        until(lambda: link.last_error == "no such rate")


def test_without_pyserial_the_extra_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "serial", None)
    refuses("mavlink", open_link, "COM3")
    (tmp_path / "serial.py").write_text("import a_part_that_is_missing\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "serial")
    refuses("mavlink", open_link, "COM3")
