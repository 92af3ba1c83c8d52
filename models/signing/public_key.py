"""Public Ed25519 keys: their ids, their files, and whether a signature is theirs."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from tokt.features.common.errors import ToktError
from tokt.models.bundle.signature import KEY_ID_DIGITS, Signature, signed_message

PUBLIC_SUFFIX = ".pub"
PUBLIC_KEY_BYTES = 32
MAX_KEY_FILE_BYTES = 64 * 1024
NEEDS_CRYPTOGRAPHY = "signatures need the package cryptography: install tokt[sign]"


@dataclass(frozen=True)
class PublicKey:
    """A public key.

    Parameters
    ----------
    raw : bytes
        As RFC 8032 encodes it, 32 bytes.
    """

    raw: bytes

    @property
    def id(self) -> str:
        """Its fingerprint: the first 32 hexadecimal digits of the SHA-256 of `raw`."""
        return hashlib.sha256(self.raw).hexdigest()[:KEY_ID_DIGITS]

    def signed(self, manifest: bytes, signature: Signature) -> bool:
        """Whether the signature is this key's, of exactly this manifest.

        Raises
        ------
        ToktError
            If the package cryptography is missing.
        """
        try:
            from cryptography.exceptions import InvalidSignature
            from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        except ImportError:
            raise ToktError(NEEDS_CRYPTOGRAPHY) from None
        try:
            key = Ed25519PublicKey.from_public_bytes(self.raw)
            key.verify(signature.value, signed_message(manifest))
        except (InvalidSignature, ValueError):
            return False
        return True


def key_file_bytes(path: Path) -> bytes:
    """Read a key's file. Raises ToktError if it is not there or far too large for a key."""
    try:
        with path.open("rb") as handle:
            data = handle.read(MAX_KEY_FILE_BYTES + 1)
    except OSError as error:
        raise ToktError(f"key {path}: {error.strerror or error}") from None
    if len(data) > MAX_KEY_FILE_BYTES:
        raise ToktError(f"key {path}: far too large for a key")
    return data


def read_public_key(path: Path) -> PublicKey:
    """Read the public key that ``tokt keygen`` wrote (PEM, SubjectPublicKeyInfo).

    Raises
    ------
    ToktError
        If it is not there or is something else, or the package cryptography is missing.
    """
    try:
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        from cryptography.hazmat.primitives.serialization import load_pem_public_key
    except ImportError:
        raise ToktError(NEEDS_CRYPTOGRAPHY) from None
    data = key_file_bytes(path)
    if b"PRIVATE KEY" in data:
        raise ToktError(
            f"key {path}: this is a private key, which stays with who signs; "
            f"give the public one ({PUBLIC_SUFFIX})"
        )
    if data.count(b"-----BEGIN") > 1:
        raise ToktError(f"key {path}: more than one key; give each in a file of its own")
    try:
        key = load_pem_public_key(data)
    except (ValueError, UnsupportedAlgorithm):
        raise ToktError(f"key {path}: not a public key as tokt keygen writes it") from None
    if not isinstance(key, Ed25519PublicKey):
        raise ToktError(f"key {path}: not an Ed25519 key")
    return PublicKey(key.public_bytes_raw())
