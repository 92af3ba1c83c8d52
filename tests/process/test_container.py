"""The ship's image as docs/how-to/containers.md runs it: TOKT_IMAGE names one that is built."""

import json
import os
import shutil
import subprocess

import pytest

from tests.waiting import until
from tokt.models.bundle.bundle import read_bundle
from tokt.models.store.store import Store

IMAGE = os.environ.get("TOKT_IMAGE")
ENGINE = shutil.which("podman") or shutil.which("docker")
pytestmark = pytest.mark.skipif(
    not (IMAGE and ENGINE), reason="TOKT_IMAGE names no image, or there is no podman or docker"
)
CONFIG = """
[source]
source = "/srv/tokt/dive"
rate = 2
[model]
store = "/srv/tokt/store"
[outputs]
udp = ["v2@127.0.0.1:1131"]
[recording]
log = "/srv/tokt/logs/dive.jsonl"
"""


def engine(*arguments, check=True):
    done = subprocess.run([ENGINE, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0 or not check, done.stderr
    return done.stdout.strip()


@pytest.fixture
def vessel(tiny, tiny_bundle, tmp_path):
    """A container that judges a dive, from a store that it cannot write to."""
    shutil.copytree(tiny.path, tmp_path / "dive")
    Store(tmp_path / "store").deploy(read_bundle(tiny_bundle))
    (tmp_path / "dive.toml").write_text(CONFIG)
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs").chmod(0o777)
    tmp_path.chmod(0o755)
    volumes = (f"{tmp_path}:/srv/tokt:ro", f"{tmp_path / 'logs'}:/srv/tokt/logs")
    options = ("--network=none", "--read-only", "--tmpfs", "/tmp", "--cap-drop=all")
    options += ("--security-opt", "no-new-privileges", "--stop-timeout", 10)
    mounts = [word for volume in volumes for word in ("--volume", volume)]
    name = engine("run", "--detach", *options, *mounts, IMAGE)
    yield name, tmp_path / "logs" / "dive.jsonl"
    engine("rm", "--force", name, check=False)


def test_it_judges_without_rights_and_ends_when_it_is_told(vessel):
    name, log = vessel
    until(log.is_file, lambda: engine("logs", name, check=False))
    listened = engine("exec", name, "tokt", "listen", "--port", 1131, "--count", 3, "--json")
    assert {json.loads(line)["v"] for line in listened.splitlines()} == {2}
    assert engine("exec", name, "id", "-u") == "1130"
    places = "/ /etc /opt/tokt/bin /srv/tokt/store /tmp /srv/tokt/logs"
    tried = f"for place in {places}; do if touch $place/x 2>&-; then echo $place; fi; done"
    assert engine("exec", name, "sh", "-c", tried) == "/tmp\n/srv/tokt/logs"
    engine("stop", name)
    assert engine("inspect", "--format", "{{.State.ExitCode}}", name) == "0"
    assert all(json.loads(line)["status"] in (0, 1, -1) for line in log.open())


def test_it_is_healthy_while_receivers_hear_something(vessel):
    name, log = vessel
    until(log.is_file, lambda: engine("logs", name, check=False))
    asked = engine("inspect", "--format", "{{json .Config.Healthcheck.Test}}", name)
    _, *healthy = json.loads(asked)
    engine("exec", name, *healthy)
    engine("kill", "--signal", "STOP", name)  # as one that hangs
    hung = subprocess.run([ENGINE, "exec", name, *healthy], check=False, capture_output=True)
    assert hung.returncode != 0
    engine("kill", "--signal", "CONT", name)
    engine("exec", name, *healthy)
