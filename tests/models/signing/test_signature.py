"""Keys, signatures, and every way to get an unsigned model past a store that asks for one."""

import dataclasses
import hashlib
import json
import stat
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives import serialization as form
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses, run_python
from tests.models.parts import pack, rehash, unpack
from tokt.features.common.canonical import json_sha256
from tokt.models.bundle.bundle import (
    Bundle,
    bundle_bytes,
    bundle_from_bytes,
    signed_parts,
    with_signature,
)
from tokt.models.bundle.signature import signature_from_bytes, signed_message
from tokt.models.signing.keys import PublicKey, read_public_key, read_signing_key, write_key_pair
from tokt.models.store.health import store_summary
from tokt.models.store.last_good import load_running
from tokt.models.store.store import Store

# Made once, by the key whose seed is the bytes 0 to 31; they stand for files on ships.
PUBLIC_KEY = bytes.fromhex("03a107bff3ce10be1d70dd18e74bc09967e4d6309ba50d5f1ddc8664125531b8")
MANIFEST = b'{"name": "old"}\n'
SIGNATURE_OF_FORMAT_1 = """{
  "format_version": 1,
  "algorithm": "ed25519",
  "key_id": "56475aa75463474c0285df5dbf2bcab7",
  "signature": "75d135471b9bfccac504d96f6a0993337d0dd03e90bd224dd66176b1f86de68a\
5cfcda2663be2fd412cd984820ce4479a0d80defe5dd5b04cd0ef69eafe6e00d"
}
"""


def with_member(bundle: Bundle, **edit: Any) -> bytes:
    """A signed bundle with other fields in its signature's member."""
    members = unpack(bundle.data)
    value = {**json.loads(members["signature.json"]), **edit}
    return pack({**members, "signature.json": json.dumps(value).encode()})


@pytest.fixture
def guarded(store, keys, signed):
    """A store that trusts ``boat`` and runs ``a/1``."""
    store.trust(keys["boat"].public, "boat", "sea trial")
    store.deploy(signed["a"])
    return store


def refused(store: Store, data: bytes, words: str) -> None:
    """Nothing takes these bytes: not deploying, not loading what somebody put into the store."""
    before = store.active().sha256
    refuses(words, store.deploy, bundle_from_bytes(data, "file"))
    path = store.path.parent / "file.tokt"
    path.write_bytes(data)
    refuses(words, store.check_file, path)
    assert store.active().sha256 == before

    sha256 = hashlib.sha256(data).hexdigest()
    file = store.bundle_file(sha256)
    file.parent.mkdir()
    file.write_bytes(data)
    sound = {store.path / name: "" for name in ("active", "history.jsonl")}
    for file in sound:  # a pointer alone would be refused, as the history contradicts it
        sound[file] = file.read_text()
        file.write_text(sound[file].replace(before, sha256))
    for load in (store.active, lambda: store.bundle(sha256, golden=False)):
        refuses(words, load)
    for file, text in sound.items():
        file.write_text(text)


def unread(store: Store, data: bytes, words: str) -> None:
    """These bytes are no bundle, wherever they are read."""
    refuses(words, bundle_from_bytes, data, "file")
    (store.path / "x.tokt").write_bytes(data)
    refuses(words, store.check_file, store.path / "x.tokt")


def test_a_signed_bundle_is_the_same_model(bundles, keys, signed):
    plain, same = bundles["a"], signed["a"]
    assert plain.signature is None
    assert same.signature.key_id == keys["boat"].public.id
    assert unpack(same.data)["manifest.json"] == unpack(plain.data)["manifest.json"]
    assert same.sha256 != plain.sha256 and same.label == plain.label
    assert keys["boat"].sign(plain, "a").data == same.data, "the same bytes each time"
    again = keys["other"].sign(same, "a")
    assert again.signature.key_id == keys["other"].public.id
    assert unpack(again.data).keys() == unpack(same.data).keys()


def test_the_signature_is_of_the_manifest_and_of_nothing_else(keys, signed):
    key = keys["boat"].public
    manifest, signature = signed_parts(signed["a"].data, "a")
    assert signature is not None and key.signed(manifest, signature)
    assert signed_message(manifest) == b"tokt bundle manifest, signature format 1\n" + manifest
    for other in (b"", manifest + b" ", manifest[:-1], signed_message(manifest)):
        assert not key.signed(other, signature)
    for at in range(0, 64, 7):
        value = bytearray(signature.value)
        value[at] ^= 1
        assert not key.signed(manifest, dataclasses.replace(signature, value=bytes(value)))


def test_a_signature_of_format_1_is_accepted():
    found = signature_from_bytes(SIGNATURE_OF_FORMAT_1.encode(), "old")
    assert found.key_id == PublicKey(PUBLIC_KEY).id
    assert PublicKey(PUBLIC_KEY).signed(MANIFEST, found)
    assert signature_from_bytes(found.to_bytes(), "again") == found


VALUE = json.loads(SIGNATURE_OF_FORMAT_1)


@pytest.mark.parametrize(
    "text",
    ["", "{", "null", "[]", "3", "[" * 3000, " " * 5000, "\xff\xfe"]
    + [json.dumps({key: value for key, value in VALUE.items() if key != less}) for less in VALUE]
    + [json.dumps({**VALUE, key: wrong}) for key in VALUE for wrong in (None, ["x"], True, "", {})]
    + [json.dumps({**VALUE, "format_version": 0}), json.dumps({**VALUE, "public_key": "00" * 32})]
    + [json.dumps({**VALUE, "signature": VALUE["signature"][:-1]})]
    + [json.dumps({**VALUE, "signature": VALUE["signature"].upper()})],
    ids=str.__len__,
)
def test_a_damaged_signature_is_refused(text, bundles):
    data = pack({**unpack(bundles["a"].data), "signature.json": text.encode("latin-1")})
    refuses(r"signature is (damaged|not of the algorithm)", bundle_from_bytes, data, "file")


PLAIN = st.none() | st.integers() | st.text(max_size=20)
NESTED = st.recursive(
    PLAIN,
    lambda item: st.lists(item, max_size=3) | st.dictionaries(st.sampled_from([*VALUE]), item),
)


@given(st.binary(max_size=300) | NESTED.map(lambda value: json.dumps(value).encode()))
def test_no_signature_member_makes_another_error(data):
    refuses("", signature_from_bytes, data, "file")


def test_no_signature_or_one_of_another_key_bundle_or_manifest(guarded, bundles, keys, signed):
    plain, theirs = bundles["b"].data, keys["other"].sign(bundles["b"], "b")
    claim = dataclasses.replace(theirs.signature, key_id=keys["boat"].public.id)
    for data, words in (
        (plain, "not signed"),
        (theirs.data, f"key {keys['other'].public.id}, which this store does not trust"),
        (with_signature(plain, claim, "b"), "signature is not that of key"),
        (with_signature(plain, signed["a"].signature, "b"), "signature is not that of key boat"),
        (rehash(unpack(signed["b"].data), {"version": "9"}), "signature is not that of key"),
    ):
        refused(guarded, data, words)


def test_weights_exchanged_under_a_signed_manifest(guarded, signed, bundles):
    members = unpack(signed["b"].data)
    members["weights.npz"] = unpack(bundles["c"].data)["weights.npz"]
    data = pack(members)
    sha256 = hashlib.sha256(data).hexdigest()
    refuses(r"weights\.npz in the bundle has been edited", bundle_from_bytes, data, "file")
    guarded.bundle_file(sha256).parent.mkdir()
    guarded.bundle_file(sha256).write_bytes(data)
    refuses("has been edited", guarded.bundle, sha256, golden=False)


def test_a_bundle_that_brings_its_own_key(guarded, bundles, keys):
    signed = keys["other"].sign(bundles["b"], "b")
    for name in ("keys.json", "signature.pub", "other.pub"):
        data = pack({**unpack(signed.data), name: keys["other"].public.raw})
        refuses("unknown or missing members", bundle_from_bytes, data, "file")
    own = with_member(signed, public_key="00" * 32)
    refuses("signature is damaged", bundle_from_bytes, own, "file")
    refused(guarded, signed.data, "does not trust")


def test_a_downgrade_to_an_older_format(guarded, signed):
    """Format 1 knows no operating point: the same weights would judge otherwise."""
    members = unpack(signed["b"].data)
    manifest = json.loads(members["manifest.json"])
    for key in ("operating_point", "sight", "frame_sizes", "manifest_sha256"):
        del manifest[key]
    manifest["format_version"] = 1
    for name in set(manifest["members"]) - {"weights.npz", "golden.npz", "lineage.npz", "card.md"}:
        del manifest["members"][name], members[name]
    manifest["manifest_sha256"] = json_sha256(manifest)
    members["manifest.json"] = json.dumps(manifest).encode()
    refused(guarded, pack(members), "signature is not that of key")


@pytest.mark.parametrize("digits", [0, 126, 130])
def test_a_truncated_signature(guarded, signed, digits):
    cut = (signed["b"].signature.value.hex() * 2)[:digits]
    unread(guarded, with_member(signed["b"], signature=cut), "signature is damaged")


@pytest.mark.parametrize("name", ["none", "ed25519ph", None])
def test_another_algorithm(signed, name):
    data = with_member(signed["b"], algorithm=name)
    refuses("not of the algorithm ed25519", bundle_from_bytes, data, "file")


def test_a_newer_signature_format(signed):
    members = unpack(signed["b"].data)
    value = {"format_version": 2, "of": "tomorrow"}
    data = pack({**members, "signature.json": json.dumps(value).encode()})
    refuses("update tokt", bundle_from_bytes, data, "file")


def test_the_signature_stripped(guarded, signed):
    members = unpack(signed["b"].data)
    del members["signature.json"]
    refused(guarded, pack(members), "not signed")


def test_two_signatures(guarded, bundles, keys):
    """A right one beside another; whichever a reader took, another could take the other."""
    right = keys["boat"].sign(bundles["b"], "b").signature.to_bytes()
    wrong = keys["other"].sign(bundles["b"], "b").signature.to_bytes()
    plain = list(unpack(bundles["b"].data).items())
    for pair in ((right, wrong), (wrong, right), (right, right)):
        data = pack([*plain, *(("signature.json", one) for one in pair)])
        unread(guarded, data, "a member is in it twice")


def test_archives_made_to_trip_the_reader(bundles):
    """Read before any signature is: no other error, and no more memory than the file takes."""
    data = bundles["a"].data
    start = int.from_bytes(data[-6:-2], "little")  # of the directory, as its end says
    name = start + 46 + len("manifest.json")
    far = bytearray(data[:name] + struct.pack("<HHQ", 1, 8, 2**63) + data[name:])
    far[start + 30 : start + 32] = struct.pack("<H", 12)
    far[start + 42 : start + 46] = b"\xff" * 4
    far[-10:-6] = struct.pack("<I", int.from_bytes(far[-10:-6], "little") + 12)
    refuses("truncated or damaged", signed_parts, bytes(far), "file")

    inner = pack([("b", bytes(100_000))])
    inside = inner[: inner.index(b"PK\1\2")]  # a member that is the content of another one, too
    outer = pack([("a", inside)])
    begin, end = outer.index(b"PK\1\2"), outer.rindex(b"PK\5\6")
    entry = bytearray(inner[inner.index(b"PK\1\2") : inner.rindex(b"PK\5\6")])
    entry[42:46] = struct.pack("<I", 31)
    directory = outer[begin:end] + entry
    tail = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 2, 2, len(directory), begin, 0)
    data = outer[:begin] + directory + tail
    refuses("the members are larger than the file", signed_parts, data, "file")


def test_who_signed_stands_in_the_history(guarded, keys, signed):
    guarded.deploy(signed["b"])
    guarded.rollback()
    boat = keys["boat"].public.id
    assert [entry.signed_by for entry in guarded.history()] == [boat] * 3
    lines = [json.loads(line) for line in (guarded.path / "history.jsonl").open()]
    assert [line["format_version"] for line in lines] == [2, 2, 2]
    found = store_summary(guarded)
    assert found["signature"] == {"key_id": boat, "checked": True}
    (key,) = found["keys"]["trusted"]
    assert (key["key_id"], key["name"], key["reason"]) == (boat, "boat", "sea trial")
    assert key["who"] and key["time"] and found["keys"]["required"] is True


def test_a_store_without_keys_takes_both_and_believes_neither(store, bundles, signed):
    store.deploy(bundles["a"])
    store.deploy(signed["b"])
    assert store_summary(store)["signature"]["checked"] is False
    lines = [json.loads(line) for line in (store.path / "history.jsonl").open()]
    assert [line["format_version"] for line in lines] == [1, 1]
    assert not any("signed_by" in line for line in lines), "yesterday's tokt reads this store"
    assert not (store.path / "keys.json").exists()


def test_trusting_a_key_refuses_the_unsigned_model_that_is_active(store, bundles, keys, signed):
    for name in "ab":
        store.deploy(bundles[name])
    store.trust(keys["boat"].public, "boat")
    for action in (store.active, store.rollback, lambda: load_running(store)):
        refuses("not signed", action)
    assert "not signed" in store_summary(store)["warnings"][0]
    store.deploy(signed["a"])
    assert store.active().sha256 == signed["a"].sha256


def test_a_key_that_is_trusted_no_more(guarded, keys, signed, bundles):
    guarded.deploy(signed["b"])
    guarded.trust(keys["other"].public, "other")
    refuses("not the id of one key", guarded.distrust, keys["boat"].public.id[:7])
    guarded.distrust(keys["boat"].public.id[:8], "laptop lost")
    for action in (guarded.active, guarded.rollback):
        refuses("does not trust", action)
    guarded.deploy(keys["other"].sign(bundles["c"], "c"))
    refuses("does not trust", guarded.rollback)
    assert guarded.active().label == "c/3"
    event = guarded.trusted_keys().events[-1]
    assert (event.action, event.name, event.reason) == ("distrust", "boat", "laptop lost")


def test_the_last_key_distrusted_opens_nothing(guarded, keys, signed, bundles):
    guarded.distrust(keys["boat"].public.id)
    for bundle in (bundles["b"], signed["b"]):
        refuses("trusts no key any more", guarded.deploy, bundle)
    refuses("trusts no key any more", guarded.active)
    guarded.accept_unsigned("the laboratory")
    assert guarded.active().label == "a/1"
    guarded.deploy(bundles["b"])
    refuses("takes unsigned bundles already", guarded.accept_unsigned)
    guarded.trust(keys["boat"].public, "boat")
    refuses("not signed", guarded.active)
    actions = [event.action for event in guarded.trusted_keys().events]
    assert actions == ["trust", "distrust", "accept unsigned", "trust"]


def spoil(change: Callable[[Any], Any]) -> Callable[[bytes], bytes]:
    return lambda data: json.dumps(change(json.loads(data))).encode()


def whole(**edit: Any) -> Callable[[bytes], bytes]:
    return spoil(lambda value: {**value, **edit})


def first(**edit: Any) -> Callable[[bytes], bytes]:
    return spoil(lambda value: {**value, "events": [{**value["events"][0], **edit}]})


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: b"\x00" * len(data),
        lambda data: data[:-20],
        lambda data: b"[" * 100_000,
        lambda data: b"null",
        spoil(lambda value: []),
        spoil(lambda value: {"format_version": 1}),
        *[whole(events=events) for events in ([], None, [None])],
        *[whole(format_version=True), whole(format_version=0), whole(more=1)],
        *[first(action=action) for action in ("accept unsigned", "distrust", "allow", None)],
        *[first(key_id="00" * 16), first(key_id=""), first(more="x")],
        *[first(public_key=key) for key in ("00" * 32, "zz", ["x"])],
    ],
)
def test_a_damaged_keys_file_refuses_everything(guarded, keys, bundles, signed, damage):
    guarded.deploy(signed["b"])
    file = guarded.path / "keys.json"
    file.write_bytes(damage(file.read_bytes()))
    spoiled = file.read_bytes()
    words = r"keys\.json is damaged"
    for action in (guarded.active, guarded.rollback, lambda: load_running(guarded)):
        refuses(words, action)
    for bundle in (signed["c"], bundles["c"]):
        refuses(words, guarded.deploy, bundle)
    refuses(words, guarded.rollback, to="1")
    refuses(words, guarded.distrust, keys["boat"].public.id)
    assert file.read_bytes() == spoiled and guarded.history()[-1].name == "b"
    assert "damaged" in store_summary(guarded)["warnings"][0]

    notices: list[str] = []
    guarded.trust(keys["boat"].public, "boat", notice=notices.append)
    (kept,) = guarded.path.glob("keys.damaged-*.json")
    assert kept.read_bytes() == spoiled and kept.name in notices[0]
    assert guarded.active().name == "b"


def test_a_keys_file_that_cannot_be_read_or_is_of_a_newer_tokt(guarded, keys):
    file = guarded.path / "keys.json"
    file.unlink()
    file.mkdir()
    refuses("keys file", guarded.active)
    file.rmdir()
    file.write_text('{"format_version": 2, "anything": 1}')
    for action in (guarded.active, lambda: guarded.trust(keys["other"].public, "other")):
        refuses("newer than this tokt reads", action)


def test_a_lost_keys_file_does_not_open_the_store(guarded, keys, bundles):
    (guarded.path / "keys.json").unlink()
    for action in (guarded.active, lambda: guarded.deploy(bundles["b"])):
        refuses(r"keys\.json is gone", action)
    with pytest.warns(UserWarning, match="is gone"):
        guarded.trust(keys["boat"].public, "boat")
    assert guarded.active().name == "a"


KEYS_OF_FORMAT_1 = """\
{"format_version": 1, "events": [
{"action": "trust", "key_id": "KEY_ID", "public_key": "PUBLIC_KEY", "name": "boat", \
"time": "2026-02-01T08:00:00+00:00", "who": "chief", "reason": "b\\u00f8lge"},
{"action": "accept unsigned", "key_id": "", "public_key": "", "name": "", \
"time": "2026-02-01T09:00:00+00:00", "who": "chief", "reason": ""},
{"action": "trust", "key_id": "KEY_ID", "public_key": "PUBLIC_KEY", "name": "boat", \
"time": "2026-02-01T10:00:00+00:00", "who": "chief", "reason": ""}
]}
"""
HISTORY_OF_FORMAT_2 = """\
{"number": 1, "action": "deploy", "sha256": "SHA256", "name": "a", "version": "1", \
"time": "2026-02-01T11:00:00+00:00", "who": "pilot", "reason": "", "signed_by": "KEY_ID", \
"format_version": 2}
"""


def test_a_store_with_keys_of_format_1_and_a_history_of_format_2(store, keys, signed, bundles):
    def filled(text: str) -> str:
        public = keys["boat"].public
        text = text.replace("KEY_ID", public.id).replace("PUBLIC_KEY", public.raw.hex())
        return text.replace("SHA256", signed["a"].sha256)

    file = store.bundle_file(signed["a"].sha256)
    file.parent.mkdir(parents=True)
    file.write_bytes(signed["a"].data)
    (store.path / "keys.json").write_text(filled(KEYS_OF_FORMAT_1))
    for name in ("active", "history.jsonl"):
        (store.path / name).write_text(filled(HISTORY_OF_FORMAT_2))
    assert store.active().label == "a/1"
    assert store.history()[0].signed_by == keys["boat"].public.id
    assert store.trusted_keys().events[0].reason == "bølge"
    refuses("not signed", store.deploy, bundles["b"])
    store.deploy(signed["b"])
    assert [entry.number for entry in store.history()] == [1, 2]


WITHOUT = """
import sys
sys.modules["cryptography"] = None
from pathlib import Path
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import read_bundle
from tokt.models.signing.keys import write_key_pair
from tokt.models.store.store import Store
store, bundle, new = Store(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3])
assert read_bundle(bundle).signature is not None
for action in (
    store.active, store.rollback, lambda: store.check_file(bundle), lambda: write_key_pair(new),
    lambda: store.deploy(read_bundle(bundle)),
):
    try:
        action()
    except ToktError as error:
        print(error)
Store(new).deploy(read_bundle(bundle))
print(Store(new).active().label)
"""


def test_without_cryptography_a_store_with_keys_refuses(guarded, signed, tmp_path):
    guarded.deploy(signed["b"])
    (tmp_path / "b.tokt").write_bytes(signed["b"].data)
    done = run_python("-c", WITHOUT, guarded.path, tmp_path / "b.tokt", tmp_path / "new")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines == ["signatures need cryptography: install the extra 'sign'"] * 5 + ["b/2"]


def test_keygen_never_replaces_a_file(tmp_path):
    pair = write_key_pair(tmp_path / "k.key")
    assert [pair.private_file.name, pair.public_file.name] == ["k.key", "k.pub"]
    assert stat.S_IMODE(pair.private_file.stat().st_mode) == 0o600 and not pair.exposed
    assert read_public_key(pair.public_file) == pair.public
    assert read_signing_key(pair.private_file, lambda: "").public == pair.public
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for missing in (None, pair.public_file, pair.private_file):
        if missing is not None:
            missing.unlink()
        refuses("is there already", write_key_pair, tmp_path / "k")
        now = {path: path.read_bytes() for path in tmp_path.iterdir()}
        assert now == {path: data for path, data in before.items() if path != missing}
        if missing is not None:
            missing.write_bytes(before[missing])
    refuses("No such file", write_key_pair, tmp_path / "none" / "k")


def test_a_key_with_a_passphrase(tmp_path):
    pair = write_key_pair(tmp_path / "k", "bølge 7")
    assert b"ENCRYPTED" in pair.private_file.read_bytes()
    assert read_signing_key(pair.private_file, lambda: "bølge 7").public == pair.public
    for wrong in ("", "bølge 8"):
        refuses("wrong passphrase", read_signing_key, pair.private_file, lambda: wrong)  # noqa: B023


def test_two_keys_in_a_file(key_files, tmp_path):
    """Only the first would be trusted, without a word."""
    both = tmp_path / "both.pub"
    public = [file.with_suffix(".pub").read_bytes() for file in key_files.values()]
    both.write_bytes(b"".join(public))
    refuses("more than one key", read_public_key, both)


def test_files_that_are_no_keys(key_files, tmp_path):
    private = key_files["boat"]
    refuses("this is a private key", read_public_key, private)
    refuses("not a private key", read_signing_key, private.with_suffix(".pub"), lambda: "")
    refuses("No such file", read_public_key, tmp_path / "none.pub")
    curve = ec.generate_private_key(ec.SECP256R1())
    pem = form.Encoding.PEM
    files = {
        "pub": curve.public_key().public_bytes(pem, form.PublicFormat.SubjectPublicKeyInfo),
        "key": curve.private_bytes(pem, form.PrivateFormat.PKCS8, form.NoEncryption()),
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    refuses("not an Ed25519 key", read_public_key, tmp_path / "pub")
    refuses("not an Ed25519 key", read_signing_key, tmp_path / "key", lambda: "")
    cut = private.with_suffix(".pub").read_bytes()[:-40]
    for junk in (b"", b"\xff" * 100, b"x" * 100_000, cut):
        (tmp_path / "junk").write_bytes(junk)
        refuses(r"not a public key|far too large", read_public_key, tmp_path / "junk")


def test_the_format_1_bundle_can_be_signed(keys, store):
    """A format older than the signature, with bytes that another tokt wrote."""
    data = (Path(__file__).parents[1] / "bundle" / "bundle_of_format_1.zip").read_bytes()
    bundle = keys["boat"].sign(bundle_from_bytes(data, "old"), "old")
    assert bundle.label == "yesterday/3"
    assert unpack(bundle.data)["manifest.json"] == unpack(data)["manifest.json"]
    store.trust(keys["boat"].public, "boat")
    assert store.deploy(bundle).signed_by == keys["boat"].public.id
    fresh = bundle_from_bytes(bundle_bytes(bundle.content), "new")
    assert fresh.signature is None, "a bundle made anew has nobody's signature"


def test_a_name_edited_by_hand_is_printable_in_what_distrusts_it(guarded, keys):
    file = guarded.path / "keys.json"
    file.write_text(file.read_text().replace('"boat"', r'"a\nb\u001b[2J"'))
    assert guarded.distrust(keys["boat"].public.id).name == "a b?[2J"


@pytest.mark.parametrize("passphrase", ["x" * 5000, "\udcf8"])
def test_a_passphrase_that_cannot_be_used(passphrase, tmp_path):
    refuses("this passphrase cannot be used", write_key_pair, tmp_path / "k", passphrase)
    assert not list(tmp_path.iterdir())
