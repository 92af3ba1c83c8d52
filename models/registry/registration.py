"""The registration of a model version: its files' hashes, whose they are, who signed that.

The hashes stand in a tag of the version, with the model's name and the run, so that the files, the
run or the tag of another version do not pass for this one's. They protect from accident alone: who
can write the workspace can write them too. A signature, in another tag, covers them and the
version's number; whose signature counts is said by whoever exports, never by the workspace. How
each promotion ended, and each deployment, stands in a tag of its own, which nothing covers.

A version's number stands in its bundle, which is made before MLflow gives the number. A tag says
as what it was made: where MLflow gave another number, the version is none
(`RegisteredVersion.own`).
"""

import hashlib
import json
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tokt.features.common.canonical import canonical_json, printable_json
from tokt.features.common.errors import ToktError
from tokt.models.bundle.signature import signature_from_bytes
from tokt.models.signing.keys import PublicKey, SigningKey
from tokt.models.store.history import stamp

FILES_TAG, SIGNATURE_TAG = "tokt.files", "tokt.signature"
PROMOTION_TAG, NUMBER_TAG = "tokt.promotion", "tokt.number"
DEPLOYMENT_TAG = "tokt.deployment"
FORMAT_VERSION = RECORD_VERSION = 1
SIGNED_PREFIX = b"tokt registration, signature format 1\n"
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class RegisteredVersion:
    """One line of ``tokt models list``."""

    name: str
    version: str
    aliases: tuple[str, ...]
    run_id: str
    tags: dict[str, str]

    @property
    def label(self) -> str:
        """``name/version``."""
        return f"{self.name}/{self.version}"

    @property
    def own(self) -> bool:
        """Whether its bundle has its number: not where its training was ended too early.

        A copy under another name, or a new name, is for `check` to refuse.
        """
        made_as = self.tags.get(NUMBER_TAG, self.label)
        return made_as == self.label or made_as.rpartition("/")[0] != self.name

    @property
    def hashed(self) -> bool:
        """Whether it was registered with hashes; version 0.1.0 wrote none."""
        return FILES_TAG in self.tags

    def check(self, file: str, data: bytes) -> None:
        """Raise ToktError unless this file is what the version was registered with."""
        if self._hashes().get(file) != hashlib.sha256(data).hexdigest():
            raise ToktError(f"model {self.label}: {file} is not the one that was registered")

    @property
    def promotions(self) -> list[dict[str, Any]]:
        """How each promotion of this version ended, the oldest first."""
        return self._records(PROMOTION_TAG)

    @property
    def deployments(self) -> list[dict[str, Any]]:
        """Each store that this version was deployed to from the registry, the oldest first."""
        return self._records(DEPLOYMENT_TAG)

    def _records(self, tag: str) -> list[dict[str, Any]]:
        found = []
        for key in sorted(key for key in self.tags if key.startswith(tag)):
            try:
                record = printable_json(self.tags[key].encode())
                known = record["format_version"] == RECORD_VERSION
            except (ValueError, TypeError, KeyError, RecursionError):
                known = False
            if not known:
                raise ToktError(f"model {self.label}: its tag {key} is damaged, or a newer tokt's")
            found.append(record)
        return found

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files with hashes; none for a version that has no hashes."""
        return tuple(self._hashes()) if self.hashed else ()

    def _hashes(self) -> Mapping[str, str]:
        try:
            found = json.loads(self.tags[FILES_TAG])
            version, hashes = found["format_version"], found["files"]
            if version == FORMAT_VERSION and not all(map(_SHA256.fullmatch, hashes.values())):
                raise ValueError("not hashes")
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            raise ToktError(f"model {self.label}: its tag {FILES_TAG} is damaged") from None
        if version != FORMAT_VERSION:
            raise ToktError(f"model {self.label} was registered by another generation of tokt")
        if (found.get("name"), found.get("run_id")) != (self.name, self.run_id):
            other = f"{found.get('name')!r} by run {found.get('run_id')!r}"
            raise ToktError(f"model {self.label}: its files were registered as {other}")
        return dict(hashes)

    def _message(self) -> bytes:
        return SIGNED_PREFIX + f"{self.label}\n{self.tags[FILES_TAG]}".encode()

    def signature(self, key: SigningKey) -> str:
        """The tag that says that `key` vouches for this version."""
        return key.signature(self._message()).to_bytes().decode()

    def check_signature(self, key: PublicKey) -> bool:
        """Whether `key` signed this registration; False where nobody signed it.

        Raises ToktError if it is signed, but not by this key or not as it now is.
        """
        if SIGNATURE_TAG not in self.tags:
            return False
        where = f"model {self.label}: its registration"
        signature = signature_from_bytes(self.tags[SIGNATURE_TAG].encode(), where)
        if signature.key_id != key.id:
            raise ToktError(f"{where} is signed by key {signature.key_id}, not by {key.id}")
        if not self.hashed or not key.made(signature, self._message()):
            raise ToktError(f"{where} has been changed: its signature does not fit")
        return True


def record_tag(tag: str, record: Mapping[str, str]) -> tuple[str, str]:
    """The tag, name and value, of what was done with a version, with who did so, when and why."""
    when, who, why = stamp(record["why"])
    about = {"format_version": RECORD_VERSION, "time": when, "who": who, "why": why}
    return f"{tag}.{time.time_ns()}", canonical_json({**record, **about})


def files_tag(name: str, run_id: str, files: Mapping[str, bytes]) -> str:
    """The tag with the hashes of a version's files, by their names."""
    hashes = {file: hashlib.sha256(data).hexdigest() for file, data in files.items()}
    about = {"format_version": FORMAT_VERSION, "name": name, "run_id": run_id}
    return canonical_json({**about, "files": hashes})
