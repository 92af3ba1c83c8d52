"""A bundle's signature: who vouches for its manifest, as the bundle's member ``signature.json``.

The manifest names the SHA-256 of every other member, so that a signature of the manifest's bytes
covers the whole bundle. It is made with Ed25519 (RFC 8032) over a prefix and those bytes: no
signature that the same key gave to anything else can be taken for one of a bundle.

This file only reads and writes the member. Whether a signature is right, and whether its key is
to be trusted, is decided by `tokt.models.signing.trusted_keys`: nothing inside a bundle is trusted.
In particular the member names its key but does not bring it.

To change the format: raise FORMAT_VERSION and SIGNED_PREFIX together, keep the reader of the old
one, and prove with a file of the old one in a test that it is still accepted.
"""

import json
import re
from dataclasses import dataclass

from tokt.features.common.errors import ToktError, check_format

FORMAT_VERSION = 1
ALGORITHM = "ed25519"
MEMBER = "signature.json"
SIGNED_PREFIX = b"tokt bundle manifest, signature format 1\n"
KEY_ID_DIGITS = 32
"""Of a key's fingerprint: 128 bits, which nobody can find a second key for."""

_MAX_BYTES = 4096
_KEYS = {"format_version", "algorithm", "key_id", "signature"}
_KEY_ID = re.compile(rf"[0-9a-f]{{{KEY_ID_DIGITS}}}")
_VALUE = re.compile(r"[0-9a-f]{128}")


@dataclass(frozen=True)
class Signature:
    """What ``signature.json`` says; not checked, and not to be believed before it is."""

    key_id: str  # fingerprint of the public key that is said to have made it, 32 hexadecimal digits
    value: bytes  # the Ed25519 signature, 64 bytes

    def to_bytes(self) -> bytes:
        """The member ``signature.json``."""
        value = {
            "format_version": FORMAT_VERSION,
            "algorithm": ALGORITHM,
            "key_id": self.key_id,
            "signature": self.value.hex(),
        }
        return (json.dumps(value, indent=2) + "\n").encode()


def signature_from_bytes(data: bytes, where: str) -> Signature:
    """Read a ``signature.json``; ToktError if it is none, newer, or made with another algorithm."""
    damaged = ToktError(f"{where}: the signature is damaged")
    if len(data) > _MAX_BYTES:
        raise damaged
    try:
        value = json.loads(data)
        check_format(value["format_version"], FORMAT_VERSION, f"{where}: the signature")
    except (ValueError, TypeError, KeyError, RecursionError):
        raise damaged from None
    if set(value) != _KEYS:
        raise damaged
    if value["algorithm"] != ALGORITHM:
        raise ToktError(f"{where}: the signature is not of the algorithm {ALGORITHM}")
    for pattern, text in ((_KEY_ID, value["key_id"]), (_VALUE, value["signature"])):
        if not (isinstance(text, str) and pattern.fullmatch(text)):
            raise damaged
    return Signature(value["key_id"], bytes.fromhex(value["signature"]))


def signed_message(manifest: bytes) -> bytes:
    """What is signed, for a manifest's raw bytes."""
    return SIGNED_PREFIX + manifest
