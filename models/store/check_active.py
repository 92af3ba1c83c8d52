"""Check a store's active bundle whole, in a process of its own.

``python -m tokt.models.store.check_active STORE`` prints one line, a JSON object with ``sha256``
and ``label`` (empty where the store has no active model) and ``fault`` (empty if the bundle is
sound), and ends with code 0 if it is sound and 2 if not.

The runtime has a new model checked like this while it goes on judging frames with the old one:
decoding and judging the golden frames would hold a frame up, and a bundle that crashed the process
would crash this one. After a code 0 the runtime loads the very same SHA-256 with
``Store.runnable(sha256, golden=False)``.
"""

import faulthandler
import json
import sys

from tokt.features.common.errors import ToktError

from .store import Store

MAX_S = 90.0
"""Seconds after which a check ends itself: whoever waited for it may have been killed."""

_FAULTY = 2


def check(store: Store) -> dict[str, str]:
    """What is active, and what is wrong with it."""
    found = {"sha256": "", "label": "", "fault": ""}
    try:
        store.check_folder()
        entry = store.active_entry()
        if entry is None:
            raise ToktError(f"store {store.path} has no active model")
        found.update(sha256=entry.sha256, label=entry.label)
        store.runnable(entry.sha256)
    except ToktError as error:
        found["fault"] = " ".join(str(error).split())
    return found


def main(arguments: list[str]) -> int:
    """Run the check; returns the exit code."""
    if len(arguments) != 1:
        print("usage: python -m tokt.models.store.check_active STORE", file=sys.stderr)
        return _FAULTY
    found = check(Store(arguments[0]))
    print(json.dumps(found), flush=True)
    return _FAULTY if found["fault"] else 0


if __name__ == "__main__":
    faulthandler.dump_traceback_later(MAX_S, exit=True)
    sys.exit(main(sys.argv[1:]))
