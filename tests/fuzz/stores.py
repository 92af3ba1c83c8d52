"""Kinds of changed deploy stores: any of their files, for a store of each sort."""

import json
import re
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import Bundle, bundle_from_bytes
from tokt.models.signing.keys import SigningKey
from tokt.models.store.health import store_summary
from tokt.models.store.last_good import load_running, remember_good
from tokt.models.store.store import Store

from .bundles import FILE, check_usable, small_bundles
from .case import Files, Kind, line_fault
from .changes import chance, changed_file

_TIME = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[^\"]*")
HOME = "store"


@cache
def _key() -> SigningKey:
    return SigningKey(Ed25519PrivateKey.from_private_bytes(bytes(range(32))))


@cache
def _bundles() -> tuple[Bundle, Bundle, Bundle]:
    one, two = (bundle_from_bytes(files[FILE], "seed") for files in small_bundles()[:2])
    return one, two, _key().sign(two, "seed")


@cache
def stores() -> list[Files]:
    """A store of two activations, one that was rolled back, and one that asks for signatures."""
    one, two, signed = _bundles()
    with tempfile.TemporaryDirectory() as folder:
        made = [Store(Path(folder) / str(number)) for number in range(3)]
        for store in made:
            store.deploy(one, "first")
            store.deploy(two, "second")
            remember_good(store, one)
        made[1].rollback("back")
        made[2].trust(_key().public, "ship", "new")
        made[2].deploy(signed, "third")
        return [
            {
                f"{HOME}/{path.relative_to(store.path)}": _timeless(path)
                for path in sorted(store.path.rglob("*"))
                if path.is_file() and path.name != "lock"
            }
            for store in made
        ]


def _timeless(path: Path) -> bytes:
    data = path.read_bytes()
    return data if path.suffix == ".tokt" else _TIME.sub(b"2016-04-20T10:00:00+00:00", data)


def _change_some(files: Files, rng: Random, others: Sequence[bytes]) -> Files:
    changed = dict(files)
    # The small files decide what is done; a changed bundle fails its hash. None is changed twice.
    names = [name for name in files if not name.endswith(".tokt") or chance(rng, 15)]
    for name in rng.sample(names, rng.choice((1, 1, 1, 2, 3))):
        kind = rng.randrange(10)
        if kind == 0:
            del changed[name]
        elif kind == 1:
            changed[name] = rng.choice(others)
        else:
            changed[name] = changed_file(name, files[name], rng, others)
    return changed


def _notice(line: str) -> None:
    assert not line_fault(line), line_fault(line)


def _read(folder: Path) -> None:
    """Everything that a ship does with a store; a refusal of one does not end the next."""
    store = Store(folder / HOME)
    refusals: list[ToktError] = []

    def tried(call: Any, *arguments: Any, **more: Any) -> Any:
        try:
            return call(*arguments, **more)
        except ToktError as error:
            _notice(str(error))
            refusals.append(error)
            return None

    if store.path.is_dir():
        shown = tried(store_summary, store)
        json.dumps(shown, ensure_ascii=False, allow_nan=False).encode("utf-8")
        for line in shown["warnings"] if shown else ():
            _notice(line)
    tried(store.history)
    for load in (store.active, lambda: load_running(store)[0]):
        bundle = tried(load)
        if bundle is not None:
            check_usable(bundle)
            store.trusted_keys().check(bundle.data, "what runs")
    tried(store.rollback, "back", notice=_notice)
    for bundle in (_bundles()[0], _bundles()[2]):
        if tried(store.deploy, bundle, "fuzz", _notice):
            assert store.active().sha256 == bundle.sha256
    if refusals:
        raise refusals[0]


KINDS = [Kind("store", stores, _read, 5, few=4, change=_change_some)]
