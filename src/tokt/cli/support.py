"""`tokt doctor --support`: one file with what a colleague on land needs to see."""

import io
import json
import os
import re
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib.metadata import distributions
from itertools import chain
from pathlib import Path

from tokt.features.common.address import without_credentials
from tokt.features.common.atomic import write_bytes
from tokt.features.common.errors import Finding, ToktError, os_errors_as
from tokt.features.common.machine import machine

_MAX_LOG_BYTES = 1_000_000
_MAX_FRAMES = 20
_PICTURES = (".png", ".jpg")
_NOT_READ = "not_read.txt"
_PIECES = re.compile(r'"(?:[^"\\]|\\.)*"|[^"]+')
"""A text in quotes, or what stands between two of them."""
_SECRET = re.compile(
    r"((?:passw\w*|passphrase|secret|token)\w*\s*[=:](?!=)\s*|bearer\s+)[^\s,;&]+", re.IGNORECASE
)


class SupportFile:
    """A zip with parts of text, whose addresses lose their credentials; what fails is said in it.

    Keys, tokens, passphrases and the environment are never read.
    """

    def __init__(self) -> None:
        self.faults: list[str] = []
        self.names: list[str] = []
        self._buffer = io.BytesIO()
        self._zip = zipfile.ZipFile(self._buffer, "w", zipfile.ZIP_DEFLATED)

    def add(self, name: str, content: Callable[[], str | bytes]) -> None:
        """Add a part; one that cannot be read is a fault, and no reason to stop."""
        try:
            data = content()
        except (ToktError, OSError, ImportError) as error:
            self.faults.append(f"{name}: {' '.join(str(error).split())}")
            return
        if isinstance(data, str):
            shown = _masked if name.endswith(".txt") else _masked_by_string
            data = "\n".join(map(shown, data.split("\n"))).encode(errors="replace")
        # Without a time: the same parts are the same file.
        self._zip.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
        self.names.append(name)

    def write(self, target: Path) -> None:
        """Write the file, with the parts that could not be read."""
        self.add(_NOT_READ, lambda: "".join(f"{fault}\n" for fault in self.faults))
        self._zip.close()
        with os_errors_as(f"cannot write {target}"):
            write_bytes(target, self._buffer.getvalue())


def write_support(
    target: Path, findings: Iterable[Finding], store: Path | None, config: Path | None, frames: bool
) -> SupportFile:
    """Pack doctor's findings, versions, configuration, store, logs, tracebacks; and frames.

    Raises ToktError if `target` cannot be written.
    """
    support = SupportFile()
    about = [finding.to_json() for finding in findings]
    support.add("doctor.json", lambda: json.dumps(about, indent=1))
    support.add("machine.json", lambda: json.dumps(machine(), indent=1))
    support.add("packages.txt", _packages)
    record = None
    if config is not None:
        from tokt.inference.config import RunConfig, read_config

        try:
            asked = RunConfig.of(read_config(config))
        except ToktError as error:
            support.faults.append(str(error))
        else:
            support.add("config.toml", asked.to_toml)
            store, record = store or asked.model.store, asked.recording.record
            for file in _logs(asked.recording.log):
                support.add(f"logs/{file.name}", partial(_end_of, file))
    if store is not None:
        support.add("store.json", lambda: _store(store))
    for file in sorted(Path(tempfile.gettempdir()).glob("tokt-traceback-*.txt")):
        support.add(f"tracebacks/{file.name}", partial(_end_of, file))
    if frames and record is not None:
        for file in _last_frames(record):
            support.add(f"frames/{file.parent.name}/{file.name}", file.read_bytes)
    support.write(target)
    return support


def _masked(text: str) -> str:
    """A text without the credentials of an address, and without what a word calls a secret."""
    return _SECRET.sub(r"\1...", without_credentials(text))


def _masked_by_string(line: str) -> str:
    """A line of JSON or TOML, which stays one: what is beside an address is no part of it."""
    pieces = _PIECES.findall(line)
    if "".join(pieces) != line:  # cut off in a text
        return _masked(line)
    return "".join(
        f'"{_masked(piece[1:-1])}"' if piece[0] == '"' else _masked(piece) for piece in pieces
    )


def _packages() -> str:
    found = {f"{one.metadata['Name']}=={one.version}\n" for one in distributions()}
    return "".join(sorted(found, key=str.lower))


def _store(path: Path) -> str:
    from tokt.models.store.health import store_summary
    from tokt.models.store.store import Store

    return json.dumps(store_summary(Store(path)), indent=1)


def _logs(log: Path | None) -> Iterator[Path]:
    """A run's log and its events, and the newest older file of each."""
    if log is None:
        return
    from tokt.inference.recording.log import older_file
    from tokt.inference.recording.run_log import events_path

    events = events_path(log)
    more = (older_file(log, 1), events, older_file(events, 1))
    yield log
    yield from (file for file in more if _written_at(file))


def _end_of(file: Path) -> str:
    """The last whole lines of a file, as many as are of use."""
    with file.open("rb") as handle:
        size = handle.seek(0, os.SEEK_END)
        handle.seek(max(0, size - _MAX_LOG_BYTES))
        if size > _MAX_LOG_BYTES:
            handle.readline()
        return handle.read(_MAX_LOG_BYTES).decode("utf-8", "replace")


def _last_frames(record: Path) -> list[Path]:
    pictures = chain.from_iterable(record.rglob(f"*{ending}") for ending in _PICTURES)
    return sorted(pictures, key=lambda file: (_written_at(file), file))[-_MAX_FRAMES:]


def _written_at(file: Path) -> float:
    """When it was written; 0 of what is not there: a recorder takes old frames away meanwhile."""
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0
