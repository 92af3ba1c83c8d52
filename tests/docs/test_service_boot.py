"""docs/tokt.service under a real systemd: it starts at boot without its source, and recovers.

A systemd of its own is booted, as a container does it: process 1 of new namespaces (mounts, PIDs,
network, cgroups), on this machine's files, of which it can write none but its own folder's. It has
no network but loopback. Needs root, and a cgroup v2 hierarchy.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
import time
from contextlib import closing, suppress
from pathlib import Path

import pytest

from tests.fixtures import ROOT
from tests.inference.test_faults import hold_row
from tests.waiting import until

SYSTEMD = Path("/lib/systemd/systemd")
PORT = 1130
TARGETS = ("multi-user", "basic", "sysinit", "shutdown")
PARTS = {"python": Path(sys.base_prefix), "packages": Path(sysconfig.get_path("purelib"))}
"""Folders of this machine that the service finds below /opt, where no option hides them."""
PROGRAM = """#!/bin/sh
export PYTHONPATH=/opt/checkout/src:/opt/packages LD_LIBRARY_PATH=/opt/python/lib
exec /opt/python/bin/python3 -m tokt "$@"
"""
BOOT = """
mount --make-rprivate /
for folder in opt srv run; do mount -t tmpfs none /$folder; done
mkdir -p /opt/tokt/bin /opt/checkout /opt/python /opt/packages /srv/tokt /run/systemd
install -m 755 $1/program /opt/tokt/bin/tokt
mount --bind $2 /opt/checkout
mount --bind $3 /opt/python
mount --bind $4 /opt/packages
mount --bind $1/data /srv/tokt
mount --bind $1/etc/systemd/system /etc/systemd/system
mount --bind $1/passwd /etc/passwd
mount --bind $1/group /etc/group
mount --bind $5 /dev/console
umount -R /sys/fs/cgroup
mount -t cgroup2 none /sys/fs/cgroup
mount --bind /proc/sys /proc/sys
for folder in / /proc/sys; do mount -o remount,bind,ro $folder; done
exec env -i container=test PATH=$PATH SYSTEMD_UNIT_PATH=/etc/systemd/system \
    SYSTEMD_GENERATOR_PATH=/none SYSTEMD_ENVIRONMENT_GENERATOR_PATH=/none \
    SYSTEMD_LOG_TARGET=console /lib/systemd/systemd --system --unit=multi-user.target
"""
RECEIVER = f"""
import socket
receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.bind(("", {PORT}))
while True:
    print(receiver.recv(65535).decode(), flush=True)
"""
UID = 1130


def cgroup_v2():
    """Where the hierarchy is mounted; None where there is none."""
    with suppress(OSError):
        for line in Path("/proc/mounts").read_text().splitlines():
            if line.split()[2] == "cgroup2":
                return Path(line.split()[1])
    return None


class Machine:
    """A booted systemd; `said` are the v2 objects that a receiver in it got, and when."""

    def __init__(self, folder):
        self.said, self.console = [], b""
        self._group = cgroup_v2() / f"tokt-test-{os.getpid()}"
        self._group.mkdir()
        self._terminal, self._theirs = os.openpty()
        apart = "unshare --cgroup --mount --uts --ipc --net --pid --fork --mount-proc"
        inner = f'echo $$ > {self._group}/cgroup.procs; exec {apart} sh -ec "$0" sh "$@"'
        places = (folder, ROOT, *PARTS.values(), os.ttyname(self._theirs))
        self._boot = subprocess.Popen(["sh", "-ec", inner, BOOT, *map(str, places)])
        self._in_thread(self._read_console)
        until(self._children, self.words)
        (process,) = self._children()
        net = f"--net=/proc/{process}/ns/net"
        command = ["nsenter", net, sys.executable, "-c", RECEIVER]
        self._receiver = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self._in_thread(self._read)

    def _in_thread(self, call):
        threading.Thread(target=call, daemon=True).start()

    def _children(self):
        pid = self._boot.pid
        return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]

    def _read(self):
        for line in self._receiver.stdout:
            self.said.append((time.monotonic(), json.loads(line)))

    def _read_console(self):
        with suppress(OSError):
            while data := os.read(self._terminal, 4096):
                self.console += data

    def words(self):
        """The end of what systemd printed."""
        return self.console.decode(errors="replace")[-2000:]

    def main_process(self):
        """The service's process, or None while there is none."""
        members = self._group / "system.slice" / "tokt.service" / "cgroup.procs"
        with suppress(OSError):
            return next(map(int, members.read_text().split()), None)
        return None

    def hears(self, true, since):
        """Wait for an object of which something is true, sent after `since`; it."""

        def sought():
            return [one for when, one in [*self.said] if when > since and true(one)]

        return until(sought, self.words)[0]

    def close(self):
        (self._group / "cgroup.kill").write_text("1")
        self._boot.wait()
        self._receiver.kill()
        self._receiver.wait()
        os.close(self._theirs)
        until(lambda: "populated 0" in (self._group / "cgroup.events").read_text())
        for folder in sorted(self._group.rglob("*/"), reverse=True):
            if folder.is_dir():
                folder.rmdir()
        self._group.rmdir()


def may_boot():
    """Why no systemd can be booted here, or an empty string."""
    if sys.platform != "linux" or os.geteuid() or not SYSTEMD.exists():
        return "needs root and systemd"
    group = cgroup_v2()
    if group is None or not os.access(group / "cgroup.procs", os.W_OK):
        return "no cgroup v2 that may be written"
    tried = "mount --make-rprivate / && mount -t cgroup2 none /mnt && mount -t tmpfs none /mnt"
    words = ["unshare", "--cgroup", "--mount", "--net", "--pid", "--fork", "sh", "-c", tried]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.stderr.strip()


def install(folder, bundle):
    """What docs/install.md says to copy, for a mission's folder in place of cameras."""
    units = folder / "etc" / "systemd" / "system"
    units.mkdir(parents=True)
    shutil.copy(ROOT / "docs" / "tokt.service", units)
    for target in TARGETS:
        shutil.copy(SYSTEMD.parent / "system" / f"{target}.target", units)
    subprocess.run(["systemctl", f"--root={folder}", "enable", "tokt"], check=True)
    (folder / "program").write_text(PROGRAM)
    group, passwd = (Path("/etc", name).read_text() for name in ("group", "passwd"))
    group += "".join(
        f"{name}:x:{UID + number}:\n"
        for number, name in enumerate(("tokt", "video", "dialout"))
        if f"\n{name}:" not in group
    )
    (folder / "group").write_text(group)
    (folder / "passwd").write_text(f"{passwd}tokt:x:{UID}:{UID}::/srv/tokt:/bin/false\n")
    data = folder / "data"
    data.mkdir()
    shutil.copy(bundle, data / "model.tokt")
    (data / "dive.toml").write_text(
        '[source]\nsource = "/srv/tokt/dive"\nrate = 4.0\n'
        '[model]\nbundle = "/srv/tokt/model.tokt"\n'
        f'[policy]\npolicy = "texture"\n[outputs]\nudp = ["v2@127.0.0.1:{PORT}"]\n'
    )
    for path in (data, *data.iterdir()):
        os.chown(path, UID, UID)
    return data


def is_verdict(said):
    return said["status"] in (0, 1) and said["latency_ms"] is not None


@pytest.mark.process
def test_it_starts_at_boot_without_its_source_and_recovers(tmp_path, tiny, tiny_bundle):
    if why := may_boot():
        pytest.skip(f"no systemd can be booted here: {why}")
    data = install(tmp_path, tiny_bundle)
    with closing(Machine(tmp_path)) as machine:
        unknown = machine.hears(lambda said: True, since=0.0)
        assert unknown["status"] == -1 and "source" in str(unknown["health"])
        shutil.copytree(tiny.path, data / "coming")
        (data / "coming").rename(data / "dive")
        machine.hears(is_verdict, since=0.0)
        for sent in (signal.SIGKILL, signal.SIGSTOP):  # it dies; it hangs
            before, began = until(machine.main_process), time.monotonic()
            os.kill(before, sent)
            until(lambda: machine.main_process() not in (None, before), machine.words)  # noqa: B023
            machine.hears(is_verdict, since=began + 0.5)
    hold_row(
        "under systemd: at boot no network and no source, then it dies, then it hangs",
        "unknown from the start, verdicts once the source is there, and after each fault",
        "restarts",
    )
