"""Models and their way to a ship: `tokt models`, `export`, `keygen`, `deploy`, `store`."""

from __future__ import annotations

import hashlib
import re
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tokt.features.common.errors import ToktError, naming, os_errors_as
from tokt.features.common.terminal import print_json, say
from tokt.features.common.workspace import DEFAULT_WORKSPACE
from tokt.models.registry.names import CHAMPION
from tokt.models.signing.passphrase import PASSPHRASE_VARIABLE, asked_passphrase, signing_key

from .help import Commands
from .options import (
    JsonOption,
    LabelFilesOption,
    MissionsOption,
    ModelArgument,
    RegisteredModelArgument,
    WorkspaceOption,
)
from .output import answer, figure, progress
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle
    from tokt.models.registry.registration import RegisteredVersion
    from tokt.models.registry.registry import Registry
    from tokt.models.signing.trusted_keys import KeyEvent
    from tokt.models.store.history import Activation
    from tokt.models.store.store import Store

models_app = Commands("models", "List, show, promote and alias registered model versions.")

FlagsOption = Annotated[
    Path | None,
    Option(help="Taxonomy file that sets which classes are obstacles. Default: as trained."),
]
SignOption = Annotated[
    Path | None, Option(help="Sign the bundle with this private key (see tokt keygen).")
]
RegisteredByOption = Annotated[
    Path | None,
    Option(help="Refuse a model whose registration this key did not sign (tokt train --sign)."),
]
StoreArgument = Annotated[Path, Argument(help="Folder of the store, local or mounted.")]
ReasonOption = Annotated[str, Option(help="Reason to keep in the store's history.")]


@models_app.command("list")
def list_(workspace: WorkspaceOption = DEFAULT_WORKSPACE, json: JsonOption = False) -> None:
    """List every registered version.

    Figures are of frames that several models held out; a store counts that `tokt deploy` was given.
    """
    from tokt.models.registry.deployments import deployments
    from tokt.models.registry.registry import Registry
    from tokt.training.compare.same_frames import figures_of_listed

    registry = Registry(workspace)
    found = registry.versions()
    figures, stores = figures_of_listed(registry, found), [deployments(item) for item in found]
    rows = [
        {**asdict(item), "held_out": figures[item.label], "deployments": on}
        for item, on in zip(found, stores, strict=True)
    ]
    answer(json, {"models": rows}, lambda: list(map(_print_listed, rows)))


def _print_listed(row: dict[str, Any]) -> None:
    aliases = "".join(f" @{alias}" for alias in row["aliases"])
    learnt = f"{row['tags'].get('extractor', '')} on {row['tags'].get('dataset', '')}"
    print(f"{row['name']}/{row['version']}{aliases}  {learnt}  {row['held_out']['words']}")
    for one in row["deployments"]:
        print(f"  {one['words']}")


@models_app.command("show")
def show(
    model: ModelArgument, workspace: WorkspaceOption = DEFAULT_WORKSPACE, json: JsonOption = False
) -> None:
    """Show a model's card: description, figures, origin."""
    from tokt.models.registry.load import is_registered_name, load_model

    bundle = load_model(model, workspace)
    content = bundle.content
    promotions: list[dict[str, Any]] = []
    if is_registered_name(model):
        from tokt.models.registry.registry import Registry

        promotions = Registry(workspace).find(bundle.label).promotions
    value = {
        "name": bundle.name,
        "version": bundle.version,
        "sha256": bundle.sha256,
        "extractor": dict(content.extractor_spec),
        "grid": content.grid.to_json(),
        "classes": list(content.model.classes),
        "obstacle": list(content.model.obstacle),
        "thresholds": content.model.thresholds.tolist(),
        "operating_point": content.operating_point.to_json(),
        "latency_frames": content.operating_point.rule.latency_frames,
        "provenance": dict(content.provenance),
        "metrics": dict(content.metrics),
        "card": content.card,
        "promotions": promotions,
    }
    lines = [*content.card.splitlines(), *map(_promotion_words, promotions)]
    answer(json, value, lambda: list(map(print, lines)))


@models_app.command("alias")
def alias(
    model: RegisteredModelArgument,
    alias: Annotated[str, Argument(help="Alias, such as champion.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Point an alias at a version."""
    from tokt.models.registry.registry import Registry

    version = Registry(workspace).set_alias(model, alias)
    said = f"{version.label} is now {version.name}@{alias}"
    answer(json, asdict(version), lambda: print(said))
    if alias == CHAMPION:
        say("note: no comparison was made; tokt models promote makes one first")


@models_app.command("promote")
def promote(
    model: RegisteredModelArgument,
    to: Annotated[str, Option(metavar="ALIAS", help="Alias to move.")] = CHAMPION,
    mission: MissionsOption = None,
    labels: LabelFilesOption = None,
    max_ms: Annotated[
        float | None,
        Option(
            help="Median time that a frame may take here, in ms. Default: 1.6 times that of the "
            "version it replaces."
        ),
    ] = None,
    force: Annotated[
        str | None, Option(help="Promote the version whatever was found; the reason is kept.")
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Move an alias to a version that is not worse.

    The two versions are compared on the patches that cross-validation held out, or on missions. One
    is refused that is worse on any dive beyond doubt, breaks its rate of false statuses, or takes
    too long. Champions of other names are shown beside it, and refuse nothing.
    """
    from tokt.models.registry.registry import Registry, check_alias
    from tokt.training.compare.compare_options import CompareOptions, compared_models
    from tokt.training.compare.promotion import judge_candidate

    if max_ms is not None and not max_ms > 0:
        raise ToktError(f"--max-ms is a time above 0, not {max_ms:g}")
    if force is not None and not force.strip():
        raise ToktError("--force needs the reason in words")
    check_alias(to)
    registry = Registry(workspace)
    version = registry.find(model)
    name = f"{version.name}@{to}"
    if to in version.aliases:
        raise ToktError(f"{version.label} is {name} already")
    before = next((one.label for one in registry.versions(version.name) if to in one.aliases), "")
    if before:
        both = [version.label, before]
        asked = CompareOptions(both, mission=mission, labels=labels, workspace=workspace)
        found = judge_candidate(compared_models(asked, progress, say), max_ms)
    else:
        silence = registry.bundle(version.label).silence
        notes = [f"there was no {name}: nothing was compared"]
        found = {"what": "", "table": [], "faults": [silence] if silence else [], "notes": notes}
    found |= _beside(registry, version, before, to)
    faults = "; ".join(found["faults"])
    refused = bool(faults) and force is None
    record = {
        **{"alias": to, "against": before, "what": found["what"], "faults": faults},
        "outcome": "refused" if refused else "forced" if faults else "promoted",
        "why": force or "",
    }
    if not refused:
        registry.set_alias(version.label, to)
    with naming(f"{name} is {before or 'no version' if refused else version.label}"):
        registry.record_promotion(version, record)
    answer(json, {"model": version.label, **record, **found}, lambda: _print_gate(found))
    if refused:
        raise ToktError(f"{version.label} does not become {name}: {faults} (but by --force WHY)")
    if not json:
        print(f"{version.label} is now {name}")


def _beside(
    registry: Registry, version: RegisteredVersion, before: str, alias: str
) -> dict[str, Any]:
    """A candidate beside other names' champions, and where each of them is deployed."""
    from tokt.models.registry.deployments import deployments
    from tokt.training.compare.same_frames import beside_champions

    others = beside_champions(registry, version, alias)
    labels = [version.label, *filter(None, [before]), *(str(one["model"]) for one in others)]
    return {
        "others": others,
        "deployments": {label: deployments(registry.find(label)) for label in labels},
    }


def _print_gate(found: dict[str, Any]) -> None:
    for row in found["table"]:
        values = f"{figure(row['champion'])} -> {figure(row['candidate'])}"
        worse = "WORSE  " if row["worse"] else ""
        print(f"  {row['dive'] or 'all':12}  {row['figure']:12}  {values}  {worse}{row['remark']}")
    if "time" in found:
        print("  (champion -> candidate, 95 % interval of the difference)")
        was, now, most = found["time"].values()
        print(f"  on {found['what']}; {was:.2f} -> {now:.2f} ms a frame, at most {most:.2f}")
    _print_beside(found["others"], found["deployments"])
    for note in found["notes"]:
        say(f"note: {note}")


def _print_beside(others: list[dict[str, Any]], deployed: dict[str, Any]) -> None:
    for line in (line for other in others for line in other["words"]):
        print(f"  {line}")
    for label, one in ((label, one) for label, ones in deployed.items() for one in ones):
        print(f"  {label} {one['words']}")
    if others and not any(deployed.values()):
        print("  none of these was deployed from this registry")


def _promotion_words(one: dict[str, Any]) -> str:
    said = {key: one.get(key) for key in ("outcome", "alias", "against", "what", "faults", "why")}
    words = "; ".join(f"{key} {value}" for key, value in said.items() if value)
    return f"promotion {one.get('time')} by {one.get('who')}: {words}"


def shipped(
    model: str,
    workspace: Path,
    taxonomy: Path | None,
    sign: Path | None,
    registered_by: Path | None,
) -> Bundle:
    """The bundle to ship: with the obstacle flags of a taxonomy file, and signed, where asked."""
    from tokt.models.registry.load import is_registered_name, load_model
    from tokt.models.signing.keys import read_public_key

    if registered_by is not None and not is_registered_name(model):
        raise ToktError(f"--registered-by goes with a registered model, not with a file ({model})")
    key, asked = signing_key(sign), registered_by is not None
    signer = None if key is None else key.public
    if registered_by is not None:
        signer = read_public_key(registered_by)
    bundle = load_model(model, workspace, signer=signer, signed=asked, notice=say)
    if taxonomy is not None:
        bundle = _flagged(bundle, taxonomy)
    if bundle.silence:
        raise ToktError(f"model {bundle.label} is not shipped: {bundle.silence}")
    if any(bundle.model.obstacle) and not bundle.golden.obstacle.any():
        unknown = "whether it can warn is not known"
        say(f"WARNING: {bundle.label} sees no obstacle in its golden frames: {unknown}")
    return bundle if key is None else key.sign(bundle, f"model {bundle.label}")


def _flagged(bundle: Bundle, taxonomy: Path) -> Bundle:
    from tokt.labels.taxonomy import Taxonomy
    from tokt.models.bundle.override_obstacle_classes import (
        PROVENANCE_KEY,
        override_obstacle_classes,
    )

    known = {item.name: item.obstacle for item in Taxonomy.load(taxonomy).classes}
    sha256 = hashlib.sha256(taxonomy.read_bytes()).hexdigest()
    found = override_obstacle_classes(bundle, known, taxonomy.name, sha256)
    if found is bundle:
        say(f"note: {taxonomy} changes nothing: {bundle.label} has these obstacles already")
        return bundle
    changed = found.content.provenance[PROVENANCE_KEY]["changed"].items()
    words = ", ".join(f"{name} is {'an obstacle' if flag else 'clear'}" for name, flag in changed)
    say(
        f"WARNING: {found.label} by {taxonomy}: {words}. The operating point was chosen for other "
        "flags and is void: status 1 with 1 patch over the threshold, in one frame"
    )
    return found


def export(
    model: ModelArgument,
    output: Annotated[
        Path, Option("--output", "-o", help="Bundle file to write, ending in .tokt.")
    ],
    taxonomy: FlagsOption = None,
    sign: SignOption = None,
    registered_by: RegisteredByOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Export a model version as a bundle, the file that is shipped."""
    from tokt.features.common.atomic import write_bytes
    from tokt.models.bundle.bundle import SUFFIX

    if output.suffix != SUFFIX:
        raise ToktError(f"a bundle's name ends in {SUFFIX}, unlike {output}")
    bundle = shipped(model, workspace, taxonomy, sign, registered_by)
    with os_errors_as(str(output)):
        write_bytes(output, bundle.data)
    key_id = None if bundle.signature is None else bundle.signature.key_id
    if json:
        found = {"file": str(output), "model": bundle.label, "sha256": bundle.sha256}
        print_json({**found, "signed_by": key_id})
        return
    print(f"{output}: {bundle.label}, {len(bundle.data) / 1e6:.1f} MB, sha256 {bundle.sha256}")
    if key_id is not None:
        print(f"signed by key {key_id}")


def keygen(
    name: Annotated[Path, Argument(help="Name or path; NAME.key and NAME.pub are written.")],
    passphrase: Annotated[
        bool,
        Option(
            "--passphrase",
            help="Encrypt the private key with a passphrase, asked for or read from "
            f"{PASSPHRASE_VARIABLE}.",
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Generate a key pair: one signs bundles, stores trust the other."""
    from tokt.models.signing.keys import write_key_pair

    asked = asked_passphrase("for the new key", new=True) if passphrase else ""
    pair = write_key_pair(name, asked)
    if pair.exposed:
        say(f"WARNING: others on this machine can read {pair.private_file}")
    if json:
        files = {"private": str(pair.private_file), "public": str(pair.public_file)}
        print_json({"key_id": pair.public.id, **files, "encrypted": passphrase})
        return
    print(f"{pair.private_file}: signs bundles; keep it, show it to nobody")
    print(f"{pair.public_file}: for stores: tokt store STORE --trust {pair.public_file}")
    print(f"key id {pair.public.id}")


def deploy(
    model: ModelArgument,
    store: StoreArgument,
    reason: ReasonOption = "",
    accept_blind: Annotated[
        bool,
        Option(
            "--accept-blind",
            help="Deploy a model that cannot tell a blurred view from open water: of compressed "
            "video, or of an older tokt. tokt run needs it too.",
        ),
    ] = False,
    taxonomy: FlagsOption = None,
    sign: SignOption = None,
    registered_by: RegisteredByOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Check a model and make it a store's active one.

    It ends with what to copy and to type for a PC that no network reaches.
    """
    from tokt.models.bundle.bundle import SUFFIX
    from tokt.models.registry.load import is_registered_name
    from tokt.models.store.store import Store

    target = Store(store)
    if model.endswith(SUFFIX) and sign is None:
        target.check_file(Path(model))
    bundle = shipped(model, workspace, taxonomy, sign, registered_by)
    bundle.check_sight(accept_blind)
    if bundle.partly_blind:
        say(f"WARNING: {bundle.partly_blind}")
    registered = is_registered_name(model)  # before a store of that name is there
    entry = target.deploy(bundle, reason, notice=say)
    if registered:
        _record_deployment(bundle, target, reason, workspace)
    carry = _carry(target, bundle)
    answer(json, {**entry.to_json(), "carry": carry}, lambda: _print_carry(store, entry, carry))


def _record_deployment(bundle: Bundle, store: Store, reason: str, workspace: Path) -> None:
    """Let the registry remember where its version went; the deployment stands without that."""
    from tokt.models.registry.registry import Registry

    try:
        Registry(workspace).record_deployment(bundle.label, store.path, bundle.sha256, reason)
    except ToktError as error:
        say(f"note: the registry may not remember this deployment: {error}")


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


def _print_carry(store: Path, entry: Activation, carry: dict[str, Any]) -> None:
    _print_activation(store, entry)
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
        Option(
            metavar="N|SHA256|NAME/VERSION",
            help="Earlier model: its number in the history, the start of its SHA-256, or its "
            "name. Default: the model that was active before.",
        ),
    ] = "",
    reason: ReasonOption = "",
    json: JsonOption = False,
) -> None:
    """Check an earlier model of a store and make it active again."""
    from tokt.models.store.store import Store

    entry = Store(store).rollback(reason, to, notice=say)
    answer(json, entry.to_json(), lambda: _print_activation(store, entry))


def store(
    store: StoreArgument,
    trust: Annotated[
        Path | None, Option(help="Trust this key; accept only signed bundles from now on.")
    ] = None,
    distrust: Annotated[
        str | None, Option(help="Refuse bundles signed by this key from now on.")
    ] = None,
    accept_unsigned: Annotated[
        bool,
        Option("--accept-unsigned", help="Trust no key and accept bundles without a signature."),
    ] = False,
    reason: ReasonOption = "",
    json: JsonOption = False,
) -> None:
    """Show a store's active model, history and trusted keys.

    An option changes the keys first.
    """
    from tokt.models.store.health import store_summary
    from tokt.models.store.store import Store

    if [trust is not None, distrust is not None, accept_unsigned].count(True) > 1:
        raise ToktError("give one of --trust, --distrust and --accept-unsigned at a time")
    change = _change_keys(Store(store), trust, distrust, accept_unsigned, reason)
    if reason and change is None:
        raise ToktError("--reason goes with --trust, --distrust or --accept-unsigned")
    value = store_summary(Store(store))
    answer(json, value, lambda: _print_store(value))


def _change_keys(
    store: Store, trust: Path | None, distrust: str | None, accept_unsigned: bool, reason: str
) -> KeyEvent | None:
    if trust is not None:
        from tokt.models.signing.keys import read_public_key

        return store.trust(read_public_key(trust), trust.stem, reason, notice=say)
    if distrust is not None:
        return store.distrust(distrust, reason, notice=say)
    return store.accept_unsigned(reason, notice=say) if accept_unsigned else None


def _print_store(value: dict[str, Any]) -> None:
    for warning in value["warnings"]:
        say(f"WARNING: {warning}")
    if value["active"] is None:
        print("active: not known" if value["warnings"] else "active: none")
    else:
        _print_active(value["active"], value["provenance"])
    signature = value["signature"]
    if signature is not None:
        checked = "checked" if signature["checked"] else "not checked: this store trusts no key"
        print(f"  signed by key {signature['key_id']} ({checked})")
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
        print(f"  {what}: {text}")
    if "obstacle_flags" in provenance:
        print(f"  obstacles set when it was shipped: {provenance['obstacle_flags']}")


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


def _print_activation(store: Path, entry: Activation) -> None:
    print(f"{store}: {entry.name}/{entry.version} is active ({entry.action})")
