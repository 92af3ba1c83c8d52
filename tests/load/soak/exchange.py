"""Exchange of a store's active model, again and again, now and then for a damaged one.

::

    1 ──deploy──> 2 ──rollback──> 1 ──deploy──> 2 ──deploy──> 3 (damaged) ──rollback──> 2 ──> 1
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tokt.models.bundle.bundle import Bundle
from tokt.models.store.store import Store

_CUT = 100


class Exchanges:
    """Take the next step of the circle each time it is asked for.

    Parameters
    ----------
    store : Path
        Made here.
    bundles : sequence of Bundle
        Three; the first is active at the start.

    Attributes
    ----------
    switches : int
        Steps at which a runtime is to go over to another model.
    refusals : int
        Steps at which it is to refuse one.
    """

    def __init__(self, store: Path, bundles: Sequence[Bundle]) -> None:
        self.switches = self.refusals = 0
        self._store = Store(store)
        self._bundles = bundles
        self._steps = 0
        self._store.deploy(bundles[0], "the first")

    def step(self) -> None:
        """Make another model the active one."""
        place = self._steps % 6
        self._steps += 1
        if place in (0, 2):
            self._store.deploy(self._bundles[1], "the other")
            self.switches += 1
        elif place == 3:
            self._store.deploy(self._bundles[2], "its disk is bad")
            self._damage(self._bundles[2])
            self.refusals += 1
        else:
            self._store.rollback("back")
            self.switches += place != 4  # what was refused never ran

    def _damage(self, bundle: Bundle) -> None:
        """Cut the file short; a runtime starts a process to look at it, which takes longer."""
        file = self._store.bundle_file(bundle.sha256)
        file.write_bytes(bundle.data[:-_CUT])
