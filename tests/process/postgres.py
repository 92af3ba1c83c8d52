"""A throw-away PostgreSQL server on a loopback port, from Debian's package."""

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import psycopg2
import pytest

from tests.calls import free_port
from tests.waiting import MAX_S, until

PASSWORD = "s3cret"  # what no error may show
_DRIVER = "postgresql+psycopg2"  # SQLAlchemy 2.1 takes psycopg 3 where none is named
_USER = "postgres"  # Debian's; PostgreSQL refuses to run as root


def _programs() -> Path:
    folders = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: path.parent.name)
    if not folders:
        pytest.skip("PostgreSQL is not installed (apt-get install postgresql)")
    return folders[-1]


@contextmanager
def postgres() -> Iterator[str]:
    """Start one; the URI of its database, with user and password."""
    programs, port = _programs(), free_port()
    as_user: dict[str, Any] = {}
    # Its user cannot look into the tests' own folder.
    with tempfile.TemporaryDirectory(prefix="tokt-postgres-", dir="/tmp") as name:
        folder = Path(name)
        if os.geteuid() == 0:
            as_user = {"user": _USER, "group": _USER, "extra_groups": []}
            shutil.chown(folder, _USER, _USER)
        data, word, log = folder / "data", folder / "password", folder / "log"
        word.write_text(PASSWORD)
        word.chmod(0o644)
        create = [programs / "initdb", "-D", data, "-U", "tokt", "-A", "scram-sha-256"]
        create += ["--pwfile", word, "-N", "-E", "UTF8", "--no-locale"]
        made = subprocess.run(create, cwd=folder, capture_output=True, text=True, **as_user)
        assert made.returncode == 0, made.stderr
        settings = {"listen_addresses": "127.0.0.1", "port": port, "fsync": "off"}
        settings["unix_socket_directories"] = ""
        command = [programs / "postgres", "-D", data]
        command += [f"--{name}={value}" for name, value in settings.items()]
        uri = f"{_DRIVER}://tokt:{PASSWORD}@127.0.0.1:{port}/postgres"
        with log.open("wb") as out:
            server = subprocess.Popen(command, cwd=folder, stdout=out, stderr=out, **as_user)
        try:
            until(lambda: _answers(uri, server, log), log.read_text)
            yield uri
        finally:
            server.send_signal(signal.SIGINT)  # clients are sent away
            server.wait(MAX_S)


def _answers(uri: str, server: "subprocess.Popen[bytes]", log: Path) -> bool:
    assert server.poll() is None, log.read_text()
    with suppress(psycopg2.OperationalError), closing(connect(uri)):
        return True
    return False


def connect(uri: str) -> Any:
    """Open a connection of psycopg2 to a database by SQLAlchemy's URI."""
    return psycopg2.connect(uri.replace(_DRIVER, "postgresql"))


def create_database(uri: str, name: str) -> str:
    """Another database of the server; its URI."""
    with closing(connect(uri)) as opened:
        opened.autocommit = True
        with opened.cursor() as cursor:
            cursor.execute(f"CREATE DATABASE {name}")
    return uri.removesuffix("postgres") + name


def waits_for_a_lock(connection: Any) -> bool:
    """Return whether any client of the server waits for a lock of another."""
    with connection.cursor() as cursor:
        cursor.execute("SELECT count(*) FROM pg_stat_activity WHERE wait_event_type = 'Lock'")
        return bool(cursor.fetchone()[0])
