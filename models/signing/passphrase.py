"""Passphrases of private keys: from the environment, or asked for at the terminal."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError

if TYPE_CHECKING:
    from .keys import SigningKey

PASSPHRASE_VARIABLE = "TOKT_KEY_PASSPHRASE"


def signing_key(file: Path | str | None) -> SigningKey | None:
    """The private key to sign with, where one was given; raises as `read_signing_key`."""
    if file is None:
        return None
    from .keys import read_signing_key

    return read_signing_key(Path(file), lambda: asked_passphrase(f"of {file}", new=False))


def asked_passphrase(whose: str, *, new: bool) -> str:
    """The passphrase of the environment, or typed, a new one twice; ToktError if there is none."""
    found = os.environ.get(PASSPHRASE_VARIABLE, "")
    if not found and sys.stdin.isatty():
        from getpass import getpass

        found = getpass(f"Passphrase {whose}: ")
        if new and found != getpass("The same again: "):
            raise ToktError("the two passphrases are not the same")
    if not found:
        raise ToktError(f"a passphrase is needed: set {PASSPHRASE_VARIABLE}, or run at a terminal")
    return found
