"""Export of a log as CSV, or as MCAP with its pictures: lines are checked first.

A line whose fields cannot be what they say is left out and counted, as a damaged one is.
"""

import csv
import io
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

from tokt.features.common.atomic import new_file
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.features.common.spreadsheet import guarded
from tokt.inference.recording.log import LogGap
from tokt.inference.report import FIELDS

from .logged_run import kind_of, logged_lines
from .mcap_file import Exported, said_at, write_mcap

CSV, MCAP = ".csv", ".mcap"


def export_log(
    log: Path,
    target: Path,
    run: str | None = None,
    source: Path | None = None,
    store: Path | None = None,
    watch: Callable[[Iterable[Any], int], Iterable[Any]] = lambda lines, _: lines,
) -> Exported:
    """Write a log's frames, heartbeats and events, over its older files, as another file.

    `log` may be the folder of a recording. `target` ends in ``.csv`` (frames and heartbeats) or
    ``.mcap``, and appears whole or not at all. Without `run`, a run's id, all are written; without
    `source` and `store` their pictures and models are those that each had. `watch` gets the lines
    and their number, and yields them: it shows progress.

    Raises ToktError if the log cannot be read, `target` cannot be written, or a library is missing.
    """
    kind = target.suffix.lower()
    if kind not in (CSV, MCAP):
        raise ToktError(f"a log is exported as FILE.mcap or FILE.csv, not {target.name}")
    if kind == MCAP and not (find_spec("mcap") and find_spec("rosbags")):
        raise ToktError("an MCAP file needs the extra 'mcap'")
    if kind == log.suffix.lower():  # it may be one of the log's own files
        raise ToktError(f"{target.name} would have the ending of the log: choose another")
    done, gaps = Exported(), list[LogGap]()
    runs = Counter(line["run"] for line in logged_lines(log, None, [], partial(_sound, Exported())))
    if run is not None and run not in runs:
        raise ToktError(f"{log} has no run {run} (it has {', '.join(runs) or 'none'})")
    total = runs.total() if run is None else runs[run]
    lines = watch(logged_lines(log, run, gaps, partial(_sound, done)), total)
    with os_errors_as(f"cannot write {target}"), new_file(target) as file:
        if kind == CSV:
            _write_csv(lines, file)
        else:
            write_mcap(lines, log, source, store, file, done)
    done.damaged += len(gaps)
    return done


def _sound(done: Exported, line: Mapping[str, Any]) -> bool:
    """Whether a line can be what it says; it is counted."""
    kind = kind_of(line)
    setattr(done, kind, getattr(done, kind) + 1)
    return kind != "damaged"


def _write_csv(lines: Iterable[Mapping[str, Any]], file: BinaryIO) -> None:
    """Frames and heartbeats as RFC 4180, in the order of the log's fields, the time before them.

    Excel takes a file for UTF-8 by its first bytes, and a text for a formula by its first sign.
    """
    text = io.TextIOWrapper(file, "utf-8-sig", errors="backslashreplace", newline="")
    rows = csv.writer(text)
    rows.writerow(["time", *(each.name for each in FIELDS)])
    for line in lines:
        if "event" not in line:
            rows.writerow([_iso_time(line), *(_cell(line.get(each.name)) for each in FIELDS)])
    text.detach()


def _iso_time(line: Mapping[str, Any]) -> str:
    if (t := said_at(line)) is None:
        return ""
    return datetime.fromtimestamp(t, UTC).isoformat(timespec="microseconds")[:-6] + "Z"


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return guarded(value)
    return json.dumps(value)
