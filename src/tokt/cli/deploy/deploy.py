"""``tokt deploy``, ``rollback`` and ``store``: one model version to one ship, and back."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tokt.cli.options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption
from tokt.cli.output import print_json, say
from tokt.cli.training.models import FlagsOption, ModelArgument, shipped
from tokt.features.common.errors import ToktError

from .keygen import SignOption

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle
    from tokt.models.signing.trusted_keys import KeyEvent
    from tokt.models.store.store import Store

StoreArgument = Annotated[Path, typer.Argument(help="The store's folder.")]
ReasonOption = Annotated[str, typer.Option(help="Reason, kept in the store's history.")]


def deploy(
    model: ModelArgument,
    store: StoreArgument,
    reason: ReasonOption = "",
    taxonomy: FlagsOption = None,
    sign: SignOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Check a model and make it the active one of a store (a local or mounted folder).

    Ends with what to copy and to type for a PC that no network reaches.
    """
    from tokt.models.bundle.bundle import SUFFIX
    from tokt.models.store.store import Store

    target = Store(store)
    if model.endswith(SUFFIX) and sign is None:
        target.check_file(Path(model))
    bundle = shipped(model, workspace, taxonomy, sign)
    entry = target.deploy(bundle, reason, notice=say)
    carry = _carry(target, bundle)
    if json:
        print_json({**entry.to_json(), "carry": carry})
        return
    _print_activation(store, entry.to_json())
    _print_carry(carry)


def _carry(store: Store, bundle: Bundle) -> dict[str, Any]:
    """What has to be copied to a PC without a network, and typed there."""
    from tokt.models.bundle.bundle import SUFFIX

    name = re.sub(r"[^\w.-]", "_", f"{bundle.name}-{bundle.version}{SUFFIX}", flags=re.ASCII)
    name = name if name[0].isalnum() else f"model{name}"  # no option, no hidden file
    return {
        "file": str(store.bundle_file(bundle.sha256)),
        "as": name,
        "sha256": bundle.sha256,
        "size_bytes": len(bundle.data),
        "signed_by": None if bundle.signature is None else bundle.signature.key_id,
        "verify": f"sha256sum {name}",
        "deploy": f"tokt deploy {name} STORE --reason WHY",
        "rollback": "tokt rollback STORE --reason WHY",
    }


def _print_carry(carry: dict[str, Any]) -> None:
    print("for a PC without a network, STORE being its store:")
    print(f"  copy      {shlex.quote(carry['file'])} to a stick, as {carry['as']}")
    print(f"  sha256    {carry['sha256']} ({carry['size_bytes']} bytes)")
    print(f"  there     {carry['verify']}      (Windows: certutil -hashfile {carry['as']} SHA256)")
    print(f"            {carry['deploy']}")
    print("            tokt doctor --store STORE")
    print(f"  and back  {carry['rollback']}")
    if carry["signed_by"] is not None:
        print(f"  signed    by key {carry['signed_by']}; once: tokt store STORE --trust KEY.pub")


def rollback(
    store: StoreArgument,
    to: Annotated[
        str,
        typer.Option(
            metavar="N|SHA256|NAME/VERSION",
            help="Earlier model: its number in the history, the start of its SHA-256, or its "
            "name. Default: the model that was active before.",
        ),
    ] = "",
    reason: ReasonOption = "",
    json: JsonOption = False,
) -> None:
    """Go back to an earlier model of the store, after checking it in full."""
    from tokt.models.store.store import Store

    entry = Store(store).rollback(reason, to, notice=say)
    if json:
        print_json(entry.to_json())
        return
    _print_activation(store, entry.to_json())


def store(
    store: StoreArgument,
    trust: Annotated[
        Path | None,
        typer.Option(
            metavar="KEY.pub",
            help="Trust this key; accept only signed bundles from now on.",
        ),
    ] = None,
    distrust: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Refuse bundles signed by this key from now on."),
    ] = None,
    accept_unsigned: Annotated[
        bool,
        typer.Option(
            "--accept-unsigned", help="Trust no key and accept bundles without a signature."
        ),
    ] = False,
    reason: ReasonOption = "",
    json: JsonOption = False,
) -> None:
    """Show a store's active model, its origin, its history and the keys it trusts.

    With one of the options, change the keys first.
    """
    from tokt.models.store.health import store_summary
    from tokt.models.store.store import Store

    if [trust is not None, distrust is not None, accept_unsigned].count(True) > 1:
        raise ToktError("give one of --trust, --distrust and --accept-unsigned at a time")
    change = _change_keys(Store(store), trust, distrust, accept_unsigned, reason)
    if reason and change is None:
        raise ToktError("--reason goes with --trust, --distrust or --accept-unsigned")
    value = store_summary(Store(store))
    if json:
        print_json(value)
        return
    _print_store(value)


def _change_keys(
    store: Store, trust: Path | None, distrust: str | None, accept_unsigned: bool, reason: str
) -> KeyEvent | None:
    if trust is not None:
        from tokt.models.signing.keys import read_public_key

        return store.trust(read_public_key(trust), trust.stem, reason, notice=say)
    if distrust is not None:
        return store.distrust(distrust, reason)
    return store.accept_unsigned(reason, notice=say) if accept_unsigned else None


def _print_store(value: dict[str, Any]) -> None:
    for warning in value["warnings"]:
        say(f"WARNING: {warning}")
    if value["active"] is None:
        print("active: not known" if value["warnings"] else "active: none")
    else:
        _print_active(value["active"], value["provenance"])
    _print_signature(value["signature"])
    if value["history"] and value["starts_with"] is None:
        print("a runtime that starts now has no model to run")
    elif value["starts_with"] is not None and value["starts_with"]["instead"]:
        print(f"a runtime that starts now: {value['starts_with']['instead']}")
    _print_keys(value["keys"])
    names = {event["key_id"]: event["name"] for event in (value["keys"] or {}).get("events", [])}
    for entry in value["history"]:
        signed_by = entry.get("signed_by", "")
        print(
            f"  {entry['number']}  {entry['time']}  {entry['action']:8}  "
            f"{entry['name']}/{entry['version']}  {entry['sha256'][:12]}  by {entry['who']}"
            f"{f'  signed by {names.get(signed_by, signed_by)}' if signed_by else ''}"
            f"{'  ' + entry['reason'] if entry['reason'] else ''}"
        )


_ORIGIN = {
    "dataset": "dataset",
    "dataset_hash": "dataset hash",
    "dataset_sources": "missions and labels",
    "mlflow_run_id": "MLflow run",
    "code_version": "code version",
}


def _print_active(active: dict[str, Any], provenance: dict[str, Any] | None) -> None:
    print(f"active: {active['name']}/{active['version']}")
    if provenance is None:
        return
    for key, what in _ORIGIN.items():
        text = str(provenance.get(key, "not recorded in the bundle"))
        print(f"  {what}: {' '.join(text.split())}")
    if "obstacle_flags" in provenance:
        print(f"  obstacles set when it was shipped: {provenance['obstacle_flags']}")


def _print_signature(signature: dict[str, Any] | None) -> None:
    if signature is None:
        return
    checked = "checked" if signature["checked"] else "not checked: this store trusts no key"
    print(f"  signed by key {signature['key_id']} ({checked})")


def _print_keys(keys: dict[str, Any] | None) -> None:
    """Nothing for a store in which nobody ever said anything of keys."""
    if keys is None or not keys["events"]:
        return
    trusted = len(keys["trusted"])
    takes = f"signed by {'this key' if trusted == 1 else f'one of these {trusted} keys'}"
    if not keys["required"]:
        takes = "also unsigned"
    elif not trusted:
        takes = "none: it trusts no key any more"
    print(f"takes bundles: {takes}")
    for event in keys["events"]:
        print(
            f"  {event['time']}  {event['action']}  {event['name']}  {event['key_id']}  "
            f"by {event['who']}{'  ' + event['reason'] if event['reason'] else ''}"
        )


def _print_activation(store: Path, entry: dict[str, Any]) -> None:
    print(f"{store}: {entry['name']}/{entry['version']} is active ({entry['action']})")
