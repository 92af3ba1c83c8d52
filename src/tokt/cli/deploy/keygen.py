"""`tokt keygen`, and the key that `--sign` names."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tokt.cli.options import JsonOption
from tokt.cli.output import print_json, say
from tokt.features.common.errors import ToktError

if TYPE_CHECKING:
    from tokt.models.signing.keys import SigningKey

PASSPHRASE_VARIABLE = "TOKT_KEY_PASSPHRASE"

SignOption = Annotated[
    Path | None,
    typer.Option(
        "--sign", metavar="KEY", help="Sign the bundle with this private key (see tokt keygen)."
    ),
]


def keygen(
    name: Annotated[Path, typer.Argument(help="Name or path; NAME.key and NAME.pub are written.")],
    passphrase: Annotated[
        bool,
        typer.Option(
            "--passphrase",
            help="Encrypt the private key with a passphrase, asked for or read from "
            f"{PASSPHRASE_VARIABLE}.",
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Generate a key pair: the private key signs bundles, stores trust the public one."""
    from tokt.models.signing.keys import write_key_pair

    pair = write_key_pair(name, _passphrase("for the new key", new=True) if passphrase else "")
    if pair.exposed:
        say(f"WARNING: others on this machine can read {pair.private_file}")
    if json:
        files = {"private": str(pair.private_file), "public": str(pair.public_file)}
        print_json({"key_id": pair.public.id, **files, "encrypted": passphrase})
        return
    print(f"{pair.private_file}: signs bundles; keep it, show it to nobody")
    print(f"{pair.public_file}: for stores: tokt store STORE --trust {pair.public_file}")
    print(f"key id {pair.public.id}")


def signing_key(path: Path) -> SigningKey:
    """The private key in a file; its passphrase is asked for if it has one."""
    from tokt.models.signing.keys import read_signing_key

    return read_signing_key(path, lambda: _passphrase(f"of {path}", new=False))


def _passphrase(whose: str, *, new: bool) -> str:
    found = os.environ.get(PASSPHRASE_VARIABLE, "")
    if not found and sys.stdin.isatty():
        prompt = f"Passphrase {whose}"
        found = typer.prompt(prompt, hide_input=True, confirmation_prompt=new, err=True)
    if not found:
        raise ToktError(f"a passphrase is needed: set {PASSPHRASE_VARIABLE}, or run at a terminal")
    return found
