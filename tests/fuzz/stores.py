"""Kinds of changed deploy stores: any of their files, for a store of each sort."""

from __future__ import annotations

import json
import re
import tempfile
from functools import cache
from pathlib import Path
from random import Random

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tokt.features.errors import ToktError
from tokt.models.bundle import Bundle, bundle_from_bytes
from tokt.models.last_good import load_running, remember_good
from tokt.models.private_key import SigningKey
from tokt.models.store import Store
from tokt.models.store_view import store_json

from .bundle_kinds import check_usable
from .bundle_seeds import small_bundles
from .bytes_changes import changed_bytes
from .case import Files, Kind, line_fault, write_files
from .json_changes import changed_json, changed_text, odd_value, text_of

_TIME = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[^\"]*")
_HOME = "store"


@cache
def _bundles() -> tuple[Bundle, Bundle, Bundle]:
    """Two bundles, and the second one signed."""
    one, two = (bundle_from_bytes(data, "seed") for data in small_bundles()[:2])
    return one, two, _key().sign(two, "seed")


@cache
def _key() -> SigningKey:
    return SigningKey(Ed25519PrivateKey.from_private_bytes(bytes(range(32))))


@cache
def _stores() -> tuple[Files, ...]:
    """A store of two activations, one that was rolled back, and one that asks for signatures."""
    one, two, signed = _bundles()
    with tempfile.TemporaryDirectory() as folder:
        stores = [Store(Path(folder) / str(number)) for number in range(3)]
        for store in stores:
            store.deploy(one, "first")
            store.deploy(two, "second")
            remember_good(store, one)
        stores[1].rollback("back")
        stores[2].trust(_key().public, "ship", "new")
        stores[2].deploy(signed, "third")
        return tuple(
            {
                f"{_HOME}/{path.relative_to(store.path)}": _timeless(path)
                for path in sorted(store.path.rglob("*"))
                if path.is_file() and path.name != "lock"
            }
            for store in stores
        )


def _timeless(path: Path) -> bytes:
    data = path.read_bytes()
    return data if path.suffix == ".tokt" else _TIME.sub(b"2016-04-20T10:00:00+00:00", data)


def _changed(rng: Random) -> Files:
    sound = rng.choice(_stores())
    files = dict(sound)
    # The small files decide what is done; a changed bundle fails its hash. None is changed twice.
    names = [name for name in sound if rng.random() < 0.15 or not name.endswith(".tokt")]
    for name in rng.sample(names, rng.choice((1, 1, 1, 2, 3))):
        kind = rng.randrange(10)
        if kind == 0:
            del files[name]
        elif kind == 1:
            files[name] = rng.choice(list(sound.values()))
        elif kind < 7 and name.endswith((".json", "active", "active.copy")):
            files[name] = _other_json(files[name], rng)
        elif kind < 7 and name.endswith(".jsonl"):
            files[name] = _other_line(files[name], rng)
        else:
            files[name] = changed_bytes(files[name], rng, list(files.values()))
    return files


def _other_json(data: bytes, rng: Random) -> bytes:
    return changed_text(json.loads(data), rng)


def _other_line(data: bytes, rng: Random) -> bytes:
    lines = data.splitlines()
    at = rng.randrange(len(lines))
    value = json.loads(lines[at])
    if rng.random() < 0.3:
        value[rng.choice(list(value))] = odd_value(rng)
    else:
        value = changed_json(value, rng)
    lines[at] = text_of(value)
    return b"\n".join(lines) + rng.choice((b"\n", b"\n", b"", b"\n\n"))


def _read(files: Files, folder: Path) -> object:
    """Everything that a ship does with a store; a refusal of one does not end the next."""
    write_files(files, folder)
    store = Store(folder / _HOME)
    refusals: list[ToktError] = []
    if (store.path).is_dir():
        shown = _try(lambda: store_json(store), refusals)
        json.dumps(shown, ensure_ascii=False, allow_nan=False).encode("utf-8")
        if isinstance(shown, dict):
            for line in shown["warnings"]:
                assert not line_fault(line), line_fault(line)
    _try(store.history, refusals)
    for load in (store.active, lambda: load_running(store)[0]):
        bundle = _try(load, refusals)
        if isinstance(bundle, Bundle):
            check_usable(bundle)
            store.trusted_keys().check(bundle.data, "what runs")
    _try(lambda: store.rollback("back", notice=_notice), refusals)
    for bundle in (_bundles()[0], _bundles()[2]):
        if _try(lambda bundle=bundle: store.deploy(bundle, "fuzz", _notice), refusals):
            assert store.active().sha256 == bundle.sha256
    for error in refusals:
        assert not line_fault(str(error)), line_fault(str(error))
    if refusals:
        raise refusals[0]
    return None


def _try(call, refusals: list[ToktError]) -> object:  # type: ignore[no-untyped-def]
    try:
        return call()
    except ToktError as error:
        refusals.append(error)
        return None


def _notice(line: str) -> None:
    assert not line_fault(line), line_fault(line)


KINDS = [Kind("store", "stores", 1, _changed, _read)]
