"""keygen, export --sign, deploy, rollback and store as a person types them."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.calls import run_python
from tokt.models.bundle.bundle import read_bundle
from tokt.models.signing.keys import read_public_key
from tokt.models.store.health import store_findings
from tokt.models.store.last_good import remember_good
from tokt.models.store.store import Store

SLIM = (
    "import sys; sys.modules.update(dict.fromkeys("
    "('mlflow', 'pandas', 'sklearn', 'joblib', 'cryptography')));"
    "from tokt.cli import main; main()"
)


@pytest.fixture
def files(tmp_path, bundles):
    found = {name: tmp_path / f"{name}.tokt" for name in bundles}
    for name, file in found.items():
        file.write_bytes(bundles[name].data)
    return found


def words(ran: Any) -> str:
    """What a command that failed said."""
    assert (ran.code, ran.out) == (2, "")
    return str(ran.err)


def test_from_a_key_to_a_signed_model_and_back(files, store, tmp_path, run_tokt):
    made = json.loads(run_tokt("keygen", tmp_path / "boat", "--json").out)
    key, public = tmp_path / "boat.key", tmp_path / "boat.pub"
    assert (made["private"], made["public"]) == (str(key), str(public))
    assert "is there already" in words(run_tokt("keygen", tmp_path / "boat"))

    signed = tmp_path / "out.tokt"
    ran = run_tokt("export", files["a"], "-o", signed, "--sign", key, "--json")
    assert json.loads(ran.out)["signed_by"] == made["key_id"]
    assert run_tokt("deploy", files["a"], store.path).code == 0
    assert run_tokt("store", store.path, "--trust", public, "--reason", "dive 12").code == 0
    assert "not signed" in words(run_tokt("deploy", files["b"], store.path))

    assert run_tokt("deploy", signed, store.path).code == 0
    ran = run_tokt("deploy", files["b"], store.path, "--sign", key, "--json")
    found = json.loads(ran.out)
    assert (found["number"], found["signed_by"]) == (3, made["key_id"])
    assert read_bundle(found["carry"]["file"]).sha256 == found["carry"]["sha256"]

    shown = run_tokt("store", store.path)
    assert (shown.code, shown.err) == (0, "")
    assert f"signed by key {made['key_id']} (checked)" in shown.out
    assert "takes bundles: signed by this key" in shown.out and "dive 12" in shown.out
    assert shown.out.splitlines()[-1].endswith("signed by boat")

    assert "not signed" in words(run_tokt("rollback", store.path, "--to", 1))
    assert "names different bundles" in words(run_tokt("rollback", store.path, "--to", "a/1"))
    sha256 = read_bundle(signed).sha256[:8].upper()
    back = run_tokt("rollback", store.path, "--to", sha256, "--reason", "it steered wrong")
    assert back.out == f"{store.path}: a/1 is active (rollback)\n"
    assert "the active model already" in words(run_tokt("rollback", store.path, "--to", 2))
    assert "no entry '7'" in words(run_tokt("rollback", store.path, "--to", 7))
    assert "no entry" in words(run_tokt("rollback", store.path, "--to", sha256[:7]))

    assert "not the id" in words(run_tokt("store", store.path, "--distrust", "0" * 32))
    gone = run_tokt("store", store.path, "--distrust", made["key_id"][:12])
    assert gone.code == 0 and "trusts no key any more" in gone.err
    assert "takes bundles: none" in gone.out
    assert "a runtime that starts now has no model to run" in gone.out
    opened = run_tokt("store", store.path, "--accept-unsigned", "--json")
    assert json.loads(opened.out)["keys"]["required"] is False
    assert run_tokt("deploy", files["c"], store.path).code == 0


def test_a_passphrase_comes_from_the_environment(files, tmp_path, run_tokt, monkeypatch):
    export = ("export", files["a"], "-o", tmp_path / "x.tokt", "--sign", tmp_path / "k.key")
    assert "a passphrase is needed" in words(run_tokt("keygen", tmp_path / "k", "--passphrase"))
    monkeypatch.setenv("TOKT_KEY_PASSPHRASE", "hav")
    assert run_tokt("keygen", tmp_path / "k", "--passphrase").code == 0
    assert run_tokt(*export).code == 0
    monkeypatch.setenv("TOKT_KEY_PASSPHRASE", "land")
    assert "wrong passphrase" in words(run_tokt(*export))
    monkeypatch.delenv("TOKT_KEY_PASSPHRASE")
    assert "a passphrase is needed" in words(run_tokt(*export))


def test_what_to_carry_to_a_pc_without_a_network_works_there(files, store, tmp_path, run_tokt):
    """Follow the printed lines to the letter, where no training tool is installed."""
    ran = run_tokt("deploy", files["b"], store.path, "--reason", "dive 12")
    assert ran.code == 0 and "for a PC without a network" in ran.out
    lines = {line.split()[0]: line.split() for line in ran.out.splitlines()[2:]}
    stick = tmp_path / "stick"
    stick.mkdir()
    source, name, sha256 = lines["copy"][1], lines["copy"][-1], lines["sha256"][1]
    (stick / name).write_bytes(Path(source).read_bytes())
    summed = subprocess.run(lines["there"][1:3], cwd=stick, capture_output=True, text=True)
    assert summed.stdout.split()[0] == sha256

    commands = re.findall(r"(?m) (tokt .*)$", ran.out)
    assert [command.split()[1] for command in commands] == ["deploy", "doctor", "rollback"]
    for command in commands[:2]:
        typed = [word.replace("STORE", "aboard") for word in command.split()[1:]]
        done = run_python("-c", SLIM, *typed, folder=stick)
        assert done.returncode == 0, done.stderr
    assert Store(stick / "aboard").active().sha256 == sha256
    typed = [word.replace("STORE", str(stick / "aboard")) for word in commands[2].split()[1:]]
    assert "no earlier model" in words(run_tokt(*typed))


def states(store: Store) -> dict[str, str]:
    return {one.name: f"{one.state}: {one.text}" for one in store_findings(store.path)}


def test_doctor_on_keys_and_the_last_good_copy(store, signed, bundles, key_files):
    store.deploy(bundles["a"])
    assert states(store)["store keys"].startswith("ok: none")
    assert states(store)["store last good copy"].startswith("ok: none")
    public = read_public_key(key_files["boat"].with_suffix(".pub"))
    store.trust(public, "boat")
    found = states(store)
    assert "not signed" in found["store active"] and "has no model to run" in found["store active"]
    store.deploy(signed["b"])
    store.deploy(signed["c"])
    remember_good(store, signed["c"])
    found = states(store)
    assert found["store keys"] == f"ok: it takes only what these signed: boat {public.id}"
    assert found["store last good copy"] == "ok: c/3, verified"
    store.bundle_file(signed["c"].sha256).write_bytes(b"damaged")
    assert "the last good copy runs instead: c/3" in states(store)["store active"]
    store.rollback()
    found = states(store)
    assert found["store active"].startswith("ok: b/2")
    copy = found["store last good copy"]
    assert copy == "note: c/3 will not be used: it was rolled back from"
    (store.path / "keys.json").write_bytes(b"?")
    assert states(store)["store keys"].startswith("fault: ")
    store.accept_unsigned(notice=str)
    assert states(store)["store keys"].startswith("note: none")
    (store.path / "active").unlink()
    assert states(store)["store active"].startswith("fault: ")
