"""Whether a deploy store is sound: its history, its active model, and every version it keeps."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from ..features.errors import ToktError
from ..features.finding import FAULT, NOTE, OK, Finding
from .bundle import read_bundle
from .store import Store


def store_findings(path: Path) -> Iterator[Finding]:
    """Examine a store without writing to it."""
    if not path.is_dir():
        what = "is not a folder" if path.exists() else "does not exist"
        yield Finding("store", FAULT, f"{path} {what}")
        return
    store = Store(path)
    yield _history(store)
    yield _active(store)
    yield _versions(path)
    leftovers = [file for where in ("", "versions/*/") for file in path.glob(f"{where}.partial-*")]
    if leftovers:
        text = f"{len(leftovers)} half-written by a command that was killed, or is running now"
        yield Finding("store partial files", NOTE, text, {"files": len(leftovers)})


def _history(store: Store) -> Finding:
    try:
        entries = store.history()
    except ToktError as error:
        return Finding("store", FAULT, str(error))
    return Finding("store", OK, f"{store.path}: {_count(len(entries), 'activation')}")


def _active(store: Store) -> Finding:
    name = "store active"
    try:
        entry = store.active_entry()
        if entry is None:
            return Finding(name, NOTE, "none; deploy a model first")
        start = time.perf_counter()
        bundle = store.active()
        seconds = time.perf_counter() - start
    except ToktError as error:
        return Finding(name, FAULT, str(error))
    text = (
        f"{bundle.label} since {entry.time}, loaded and golden values recomputed "
        f"in {seconds * 1000:.0f} ms"
    )
    figures = {"model": bundle.label, "sha256": bundle.sha256, "load_s": round(seconds, 4)}
    return Finding(name, OK, text, figures)


def _versions(path: Path) -> Finding:
    name = "store versions"
    folders = sorted(folder for folder in path.glob("versions/*") if folder.is_dir())
    faults = [fault for folder in folders if (fault := _version_fault(folder))]
    figures = {"versions": len(folders), "faults": faults}
    if faults:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        text = f"{len(faults)} of {len(folders)} cannot be used: {faults[0]}{more}"
        return Finding(name, FAULT, text, figures)
    verified = ", every one verified" if folders else ""
    return Finding(name, OK, f"{_count(len(folders), 'bundle')}{verified}", figures)


def _version_fault(folder: Path) -> str:
    """What is wrong with one kept bundle; a version is a folder named by its bundle's hash."""
    try:
        bundle = read_bundle(folder / "bundle.tokt")
    except ToktError as error:
        return str(error)
    if bundle.sha256 != folder.name:
        return f"bundle {folder / 'bundle.tokt'}: the file is not the one that was deployed"
    return ""


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
