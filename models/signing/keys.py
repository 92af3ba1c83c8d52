"""Ed25519 keys: made in pairs, written to files and read, to sign bundles and check signatures."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError, os_errors_as
from tokt.models.bundle.bundle import Bundle, bundle_from_bytes, signed_parts, with_signature
from tokt.models.bundle.signature import KEY_ID_DIGITS, Signature, signed_message

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

PRIVATE_SUFFIX, PUBLIC_SUFFIX = ".key", ".pub"
PUBLIC_KEY_BYTES = 32
MAX_KEY_FILE_BYTES = 64 * 1024
_FOR_OWNER = 0o600
_FOR_ALL = 0o644
_OTHERS = 0o077


@contextmanager
def _cryptography() -> Iterator[None]:
    """Around imports of the package cryptography: say what to install where it is missing."""
    try:
        yield
    except ImportError:
        raise ToktError("signatures need cryptography: install the extra 'sign'") from None


@dataclass(frozen=True)
class PublicKey:
    """A public key."""

    raw: bytes  # 32, as RFC 8032 encodes it

    @property
    def id(self) -> str:
        """Its fingerprint: the first 32 hexadecimal digits of the SHA-256 of `raw`."""
        return hashlib.sha256(self.raw).hexdigest()[:KEY_ID_DIGITS]

    def signed(self, manifest: bytes, signature: Signature) -> bool:
        """Whether the signature is this key's, of this manifest; ToktError without cryptography."""
        return self.made(signature, signed_message(manifest))

    def made(self, signature: Signature, message: bytes) -> bool:
        """Whether the signature is this key's, of this message; raises as `signed` does.

        What is signed begins with a prefix of its kind, so that no signature passes for another's.
        """
        with _cryptography():
            from cryptography.exceptions import InvalidSignature
            from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        try:
            key = Ed25519PublicKey.from_public_bytes(self.raw)
            key.verify(signature.value, message)
        except (InvalidSignature, ValueError):
            return False
        return True


def _key_file_bytes(path: Path) -> bytes:
    """Read a key's file. Raises ToktError if it is not there or far too large for a key."""
    with os_errors_as(f"key {path}"), path.open("rb") as handle:
        data = handle.read(MAX_KEY_FILE_BYTES + 1)
    if len(data) > MAX_KEY_FILE_BYTES:
        raise ToktError(f"key {path}: far too large for a key")
    return data


def read_public_key(path: Path) -> PublicKey:
    """Read the public key that ``tokt keygen`` wrote (PEM, SubjectPublicKeyInfo).

    Raises ToktError if it is not there or is something else, or the package cryptography is
    missing.
    """
    with _cryptography():
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        from cryptography.hazmat.primitives.serialization import load_pem_public_key
    data = _key_file_bytes(path)
    if b"PRIVATE KEY" in data:
        words = "this is a private key, which stays with who signs; give the public one"
        raise ToktError(f"key {path}: {words} ({PUBLIC_SUFFIX})")
    if data.count(b"-----BEGIN") > 1:
        raise ToktError(f"key {path}: more than one key; give each in a file of its own")
    try:
        key = load_pem_public_key(data)
    except (ValueError, UnsupportedAlgorithm):
        raise ToktError(f"key {path}: not a public key as tokt keygen writes it") from None
    if not isinstance(key, Ed25519PublicKey):
        raise ToktError(f"key {path}: not an Ed25519 key")
    return PublicKey(key.public_bytes_raw())


@dataclass(frozen=True)
class KeyPair:
    """The files of a new pair of keys."""

    private_file: Path
    public_file: Path
    public: PublicKey
    exposed: bool  # whether others here can read the private one, as on a stick without owners


def write_key_pair(name: Path, passphrase: str = "") -> KeyPair:
    """Make a pair of keys, ``NAME.key`` and ``NAME.pub``; a file that is there is never replaced.

    `name` is given with or without the ending ``.key``. The passphrase encrypts the private key; an
    empty one does not.

    Raises ToktError if one of the files is there already or cannot be written, the passphrase
    cannot be used, or the package cryptography is missing.
    """
    with _cryptography():
        from cryptography.hazmat.primitives import serialization as form
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    base = name.with_suffix("") if name.suffix == PRIVATE_SUFFIX else name
    private_file = base.with_name(base.name + PRIVATE_SUFFIX)
    public_file = base.with_name(base.name + PUBLIC_SUFFIX)
    key = Ed25519PrivateKey.generate()
    try:
        sealed = (
            form.BestAvailableEncryption(passphrase.encode()) if passphrase else form.NoEncryption()
        )
        private = key.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, sealed)
    except ValueError:  # too long for cryptography, or not text
        raise ToktError(f"key {private_file}: this passphrase cannot be used") from None
    public = key.public_key().public_bytes(
        form.Encoding.PEM, form.PublicFormat.SubjectPublicKeyInfo
    )
    _write_new(public_file, public, _FOR_ALL)
    try:
        _write_new(private_file, private, _FOR_OWNER)
    except ToktError:
        public_file.unlink()
        raise
    exposed = os.name == "posix" and bool(private_file.stat().st_mode & _OTHERS)
    return KeyPair(private_file, public_file, SigningKey(key).public, exposed)


def _write_new(path: Path, data: bytes, mode: int) -> None:
    """Write a file that must not be there yet; not by renaming, which would replace one.

    A killed process can leave it empty, which is refused as a key and replaced by nobody.
    """
    with os_errors_as(f"key {path}"):
        try:
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        except FileExistsError:
            raise ToktError(f"key {path}: is there already, and is never replaced") from None
        try:
            with os.fdopen(handle, "wb") as opened:
                opened.write(data)
                opened.flush()
                os.fsync(handle)
        except OSError:
            with suppress(OSError):
                path.unlink()
            raise


class SigningKey:
    """A private key, ready to sign."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key
        self.public = PublicKey(key.public_key().public_bytes_raw())

    def signature(self, message: bytes) -> Signature:
        """Sign a message, see `PublicKey.made`."""
        return Signature(self.public.id, self._key.sign(message))

    def sign(self, bundle: Bundle, where: str) -> Bundle:
        """The same model, signed, in place of any signature it had; checked whole again."""
        manifest, _ = signed_parts(bundle.data, where)
        signature = self.signature(signed_message(manifest))
        if not self.public.signed(manifest, signature):
            raise ToktError(f"{where}: signing it failed on this machine")
        return bundle_from_bytes(with_signature(bundle.data, signature, where), where)


def read_signing_key(path: Path, passphrase: Callable[[], str]) -> SigningKey:
    """Read the private key of ``tokt keygen`` (PEM, PKCS 8), with its passphrase if it has one.

    Raises ToktError if it is not there or is something else, the passphrase is wrong, or the
    package cryptography is missing.
    """
    with _cryptography():
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        from cryptography.hazmat.primitives.serialization import load_pem_private_key
    data = _key_file_bytes(path)
    sealed = b"ENCRYPTED PRIVATE KEY" in data
    try:
        key = load_pem_private_key(data, passphrase().encode() if sealed else None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        what = "wrong passphrase, or damaged" if sealed else "not a private key of tokt keygen"
        raise ToktError(f"key {path}: {what}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise ToktError(f"key {path}: not an Ed25519 key")
    return SigningKey(key)
