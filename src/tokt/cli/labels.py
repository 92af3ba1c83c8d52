"""`tokt label`, the labelling page, and `tokt labels`: label files, counts, agreement, audit."""

from __future__ import annotations

import getpass
import threading
from collections.abc import Iterable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from tokt.features.common.errors import ToktError, counted, printable
from tokt.features.common.terminal import print_json, say
from tokt.features.common.workspace import DEFAULT_WORKSPACE
from tokt.labels.formats import NAMES

from . import InterruptEnds
from .help import Commands
from .options import JsonOption, SharpFramesOption, TaxonomyOption, WorkspaceOption
from .output import answer, progress
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.features.frames.grid import Grid
    from tokt.features.frames.mission import Mission
    from tokt.labels.agreement import Agreement, ClassAgreement
    from tokt.labels.formats.audit_csv import Audit
    from tokt.labels.record import LabelRecord
    from tokt.labels.store.store import LabelStore
    from tokt.models.bundle.bundle import Bundle

labels_app = Commands(
    "labels", "Import, export, back up, count, audit and compare labels.", no_args_is_help=True
)

LabelFile = Annotated[Path, Argument(help="Label file (.csv, .json, .xml) or folder of patches.")]
FormatOption = Annotated[
    str | None,
    Option(
        "--format",
        metavar="|".join(NAMES),
        help="Format of the file. Default: by ending and content; required to export a .json.",
    ),
]
MissionDirOption = Annotated[
    Path | None, Option(help="Folder of the mission's frames; needed by all formats but csv.")
]
MissionOption = Annotated[
    str | None,
    Option(metavar="NAME", help="Mission name in the labels. Default: the name of --mission-dir."),
]
_LONG = 100_000  # labels whose import takes more than a second
_SHOWN = 10  # labels of an audit


def label(
    mission: Annotated[Path, Argument(help="[NAME=]DIR: a folder of frames or a video file.")],
    port: Annotated[
        int, Option(help="Port of the page; 0 takes any free port.", min=0, max=65535)
    ] = 8118,
    host: Annotated[
        str, Option(help="Address to serve on. Default: this computer alone.")
    ] = "127.0.0.1",
    token: Annotated[
        str | None, Option(help="Token to require. Default: the workspace's own.")
    ] = None,
    no_token: Annotated[
        bool, Option("--no-token", help="Admit every account of this computer; not with --host.")
    ] = False,
    model: Annotated[
        str | None,
        Option(
            help="Model that suggests: a .tokt file or name. Default: the one trained in the page."
        ),
    ] = None,
    annotator: Annotated[
        str | None, Option(help="Name proposed to who opens the page. Default: the user's name.")
    ] = None,
    calibration: Annotated[
        Path | None,
        Option(help="Carry labels from the left camera to the right one by this calibration."),
    ] = None,
    sharp_frames: SharpFramesOption = None,
    findings: Annotated[
        Path | None, Option(help="Review findings of this mission (.geojson of `tokt findings`).")
    ] = None,
    no_browser: Annotated[
        bool, Option("--no-browser", help="Print the address and open no browser.")
    ] = False,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    taxonomy: TaxonomyOption = None,
    grid: Annotated[str, Option(help="Grid of patches to label.")] = "10x10@360",
) -> None:
    """Label a mission's patches in the browser, until Ctrl-C."""
    with InterruptEnds():
        from tokt import __version__
        from tokt.features.common.address import kept_token
        from tokt.features.frames.grid import Grid
        from tokt.features.frames.mission import open_mission
        from tokt.inference.sight import unseen_causes
        from tokt.labels.page.api.access import TOKEN_FILE
        from tokt.labels.page.api.serve import listen, serve
        from tokt.labels.page.state.session import open_session

        if token is not None and not token.strip():
            raise ToktError("--token is empty")
        if token is not None and no_token:
            raise ToktError("--token and --no-token exclude each other")
        patches = Grid.parse(grid)
        frames = open_mission(mission)
        bundle = _suggesting(model, frames, patches, workspace)
        bundle = _with_sharp_frames(bundle, frames, sharp_frames)
        carry = None
        if calibration is not None:
            from tokt.inference.stereo.carried_labels import LabelCarrier
            from tokt.training.calibration.any_form import read_calibration_file

            if len(frames.cameras) < 2:
                raise ToktError(f"--calibration: {frames.name} has the frames of one camera only")
            carry = LabelCarrier(read_calibration_file(calibration, say), patches).carry
        view = "" if findings is None else _review(findings, frames, patches, workspace)
        kept = None if no_token else token or kept_token(workspace / TOKEN_FILE)
        address = listen(host, port, kept)
        session = open_session(
            mission=frames,
            workspace=workspace,
            grid=patches,
            annotator=annotator or _user(),
            version=__version__,
            taxonomy=taxonomy,
            bundle=bundle,
            sight=partial(unseen_causes, grid=patches),
        )
        session.carry = carry

        def ready() -> None:
            print(f"labelling {frames.name} at {address.url}{view} (Ctrl-C ends)")
            if not no_browser:
                _open_browser(address.opens_once + view)

        serve(session, address.socket, address.rules, ready)


def _review(findings: Path, frames: Mission, grid: Grid, workspace: Path) -> str:
    """Keep findings as an audit of the workspace; the part of the address that shows it."""
    from urllib.parse import quote

    from tokt.labels.formats.audit_csv import write_audit
    from tokt.labels.formats.findings import findings_audit

    audit = findings_audit(findings, frames.name, grid)
    write_audit(workspace, audit)
    return f"#/audit/{quote(audit.name, safe='')}"


def _suggesting(model: str | None, frames: Mission, grid: Grid, workspace: Path) -> Bundle | None:
    """The model asked for, else the one that was trained through the page, if it still fits."""
    from tokt.labels.page.state.session import own_model_file
    from tokt.models.bundle.bundle import read_bundle

    if model is not None:
        from tokt.models.registry.load import load_model

        return load_model(model, workspace)
    trained = own_model_file(workspace, frames)
    try:
        bundle = read_bundle(trained) if trained.is_file() else None
    except ToktError as error:
        say(f"no suggestions: {error}")
        return None
    if bundle is not None and bundle.grid != grid:
        say(f"no suggestions: model {bundle.label} has the grid {bundle.grid}")
        return None
    return bundle


def _with_sharp_frames(bundle: Bundle | None, frames: Mission, sharp: Path | None) -> Bundle | None:
    """Let a model say clear of a camera that it did not learn: who labels looks at each frame."""
    from tokt.features.frames.mission import frame_size, open_mission
    from tokt.inference.sharp_frames import are_mostly_hidden, measure_sharp_frames

    if bundle is None or not bundle.sight:
        return bundle
    if sharp is not None:
        named = open_mission(sharp)
        return bundle.with_sight(measure_sharp_frames(named, frames.masks, accept_blind=True))
    if not are_mostly_hidden(bundle.sight, frames):
        return bundle
    width, height = frame_size(frames)
    if (height, width) in {(one.height, one.width) for one in bundle.sight}:
        say(
            f"note: most frames of {frames.name} show less detail than those that model "
            f"{bundle.label} learnt. The port may be fogged. If it is another camera, name sharp "
            "frames of it (--sharp-frames)"
        )
        return bundle
    say(
        f"note: model {bundle.label} learnt from no frames of {width}x{height}: those of "
        f"{frames.name} are taken for sharp. tokt run does so with --sharp-frames"
    )
    return bundle.with_sight(measure_sharp_frames(frames, accept_blind=True))


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        raise ToktError("this user has no name; say who labels with --annotator") from None


def _open_browser(url: str) -> None:
    import webbrowser

    # Some browsers return only when they are closed.
    threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


@labels_app.command("audit")
def audit_labels(
    reference: Annotated[
        str, Argument(metavar="DATASET|MODEL", help="NAME, NAME@HASH, NAME@ALIAS or NAME/VERSION.")
    ],
    output: Annotated[
        Path | None,
        Option("--output", "-o", metavar="FILE.csv", help="Label file to write, with reasons."),
    ] = None,
    top: Annotated[int | None, Option(help="Show the worst N only.", min=1)] = None,
    folds: Annotated[
        int | None,
        Option(help="Folds of a dataset's cross-validation. Default: as for train.", min=2),
    ] = None,
    jobs: Annotated[int, Option(help="Processes for features; -1 for one per core.")] = -1,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Rank labels that held-out models contradict; change none.

    The ranking is kept in the workspace: the labelling page's review sheet shows it under Audit.
    """
    from tokt.labels.formats.audit_csv import write_audit, write_audit_csv
    from tokt.training.fitting.label_audit import audit, audit_input_named

    found = audit(
        audit_input_named(reference, workspace, folds), workspace / "cache", progress, top, jobs
    )
    kept = write_audit(workspace, found)
    if output is not None:
        write_audit_csv(output, found)
    value = {
        "name": found.name,
        "of": found.of,
        "rule": found.rule,
        "file": str(kept),
        "csv": str(output) if output else None,
        "doubted": len(found.patches),
        "patches": [asdict(patch) for patch in found.patches],
    }
    answer(json, value, lambda: _print_audit(found, [kept, output] if output else [kept]))


def _print_audit(found: Audit, files: list[Path]) -> None:
    print(f"{found.of}: {counted(len(found.patches), 'label')} contradicted")
    print(f"  {found.rule}")
    for patch in found.patches[:_SHOWN]:
        where = f"{patch.mission} {patch.camera} {patch.frame} row {patch.row} col {patch.col}"
        print(f"  {patch.margin:8.2f}  {where}: labelled {patch.label}, {patch.reason}")
    if len(found.patches) > _SHOWN:
        print(f"  ... and {len(found.patches) - _SHOWN} more")
    for file in files:
        print(f"  in {file}")


@labels_app.command("import")
def import_labels(
    file: LabelFile,
    annotator: Annotated[
        str | None, Option(help="Annotator, where the file names none. Default: the file's name.")
    ] = None,
    grid: Annotated[str, Option(help="Grid, where the file names none.")] = "10x10@360",
    file_format: FormatOption = None,
    mission_dir: MissionDirOption = None,
    mission: MissionOption = None,
    folder: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help="What the file calls the mission's folder. Default: as the folder, or --mission.",
        ),
    ] = None,
    camera: Annotated[str, Option(help="Camera of a viame file without file names.")] = "left",
    classes: Annotated[
        list[str] | None,
        Option(
            "--map",
            metavar="THEIRS=OURS",
            help="Map a class of the file to one of ours; THEIRS= leaves it out. Repeatable.",
        ),
    ] = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Add a label file to the workspace. What is odd in it is left out, and shown."""
    from tokt.labels.formats.formats import FORMATS
    from tokt.labels.formats.options import no_progress
    from tokt.labels.labels import Labels
    from tokt.labels.store.store import FILE_NAME

    read = Labels.read(
        file,
        format=file_format,
        annotator=annotator,
        grid=grid,
        mission_dir=mission_dir,
        mission=mission,
        folder=folder,
        camera=camera,
        classes=_class_map(classes or []),
        taxonomy=taxonomy,
        workspace=workspace,
    )
    records, n = read.records, len(read)
    added = read.add_to(workspace, progress if n > _LONG else no_progress)
    annotators = sorted({record.annotator for record in records})
    if json:
        where = {"file": str(file), "format": read.format, "store": str(workspace / FILE_NAME)}
        kinds = ("new", "changed", "unchanged", "suggestions", "settled")
        counts = {kind: getattr(added, kind) for kind in kinds}
        print_json(
            {**where, "annotators": annotators, "labels": n, **counts, "lost": list(read.lost)}
        )
        return
    more = f", {counted(added.suggestions, 'suggestion')}" if added.suggestions else ""
    more += f", {added.settled} settled" if added.settled else ""
    print(
        f"{file}: {counted(n, 'label')} by {', '.join(annotators)}: {added.new} new,"
        f" {added.changed} changed, {added.unchanged} known already{more}"
    )
    _say_lost(FORMATS[read.format].title, read.lost)


@labels_app.command("export")
def export_labels(
    file: LabelFile,
    mission: Annotated[
        str | None,
        Option(
            metavar="NAME", help="Export this mission only. Default: the name of --mission-dir."
        ),
    ] = None,
    annotator: Annotated[str | None, Option(help="Export this annotator only.")] = None,
    camera: Annotated[str | None, Option(help="Export this camera only.")] = None,
    grid: Annotated[str | None, Option(help="Export this grid only.")] = None,
    full: Annotated[
        bool,
        Option(
            "--full", help="csv: add annotator, time, grid, source, model_version, blind, note."
        ),
    ] = False,
    file_format: FormatOption = None,
    mission_dir: MissionDirOption = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Write the labels in force to a file, sorted by patch."""
    from tokt.features.frames.grid import Grid
    from tokt.labels import export
    from tokt.labels.formats.formats import FORMATS, format_named, format_to_write
    from tokt.labels.formats.options import WriteOptions
    from tokt.labels.labels import images_in
    from tokt.labels.taxonomy import load_taxonomy

    chosen = format_named(file_format) if file_format else format_to_write(file)
    images = images_in(mission_dir, mission)
    name = mission or (images.name if images else None)
    wanted = export.Wanted(name, annotator, Grid.parse(grid) if grid else None, camera)
    options = WriteOptions(load_taxonomy(workspace, taxonomy), images, full, progress=progress)
    with _open_store(workspace) as store:
        written = export.export_labels(store, file, chosen, wanted, options)
    if json:
        about = {"file": str(file), "format": chosen, "store": str(store.path)}
        print_json({**about, "labels": written.labels, "lost": written.lost})
        return
    say(f"{file}: {written.labels} labels")
    _say_lost(FORMATS[chosen].title, written.lost)


def _class_map(pairs: Iterable[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for pair in pairs:
        theirs, sign, ours = pair.partition("=")
        if not sign:
            raise ToktError(f"--map {pair!r} is not of the form THEIRS=OURS")
        found[theirs] = ours
    return found


def _say_lost(title: str, lost: Iterable[str]) -> None:
    for line in lost:
        say(f"{title}: {line}")


@labels_app.command("backup")
def back_up_labels(
    file: Annotated[Path, Argument(help="File to write; one that is there is refused.")],
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Copy the label store into one checked file, even in use.

    To restore, end `tokt label`, remove labels.db-wal and labels.db-shm from the workspace, and
    put the file there as labels.db. labels.db copied by hand lacks what labels.db-wal holds.
    """
    from tokt.labels.store.backup import back_up

    with _open_store(workspace) as store:
        events = back_up(store, file)
    value = {"file": str(file), "store": str(store.path), "events": events}
    answer(json, value, lambda: print(f"{file}: {events} events, checked"))


@labels_app.command("stats")
def show_stats(workspace: WorkspaceOption = DEFAULT_WORKSPACE, json: JsonOption = False) -> None:
    """Count frames, patches and classes by mission and annotator."""
    from tokt.labels.taxonomy import UNSURE, load_taxonomy

    with _open_store(workspace) as store:
        stats = store.stats()
    if json:
        print_json({"store": str(store.path), "annotators": [asdict(entry) for entry in stats]})
        return
    known = (*load_taxonomy(workspace).names, UNSURE)
    used = {label for entry in stats for label in entry.counts}
    labels = [name for name in known if name in used] + sorted(used - set(known))
    rows = []
    for entry in stats:
        counts = [entry.counts.get(label, 0) for label in labels]
        numbers = [entry.frames, entry.patches, *counts, entry.blind, entry.events]
        rows.append([entry.mission, entry.annotator, *map(str, numbers)])
    _print_table(("mission", "annotator"), ("frames", "patches", *labels, "blind", "events"), rows)


@labels_app.command("agreement")
def show_agreement(
    a: Annotated[str, Argument(help="Label file, or annotator in the store.")],
    b: Annotated[str, Argument(help="Label file or annotator to compare with A.")],
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Compare two annotators: kappa, agreement by class, confusion."""
    from tokt.labels.agreement import agreement
    from tokt.labels.taxonomy import FILE_NAME as TAXONOMY_FILE
    from tokt.labels.taxonomy import load_taxonomy

    classes = load_taxonomy(workspace, taxonomy)
    found = agreement(_said_by(a, workspace, taxonomy), _said_by(b, workspace, taxonomy), classes)
    file = taxonomy or workspace / TAXONOMY_FILE
    value = {"a": a, "b": b, **asdict(found)}
    answer(json, value, lambda: _print_agreement(a, b, found, file))


def _open_store(workspace: Path) -> LabelStore:
    from tokt.labels.store.store import FILE_NAME, LabelStore

    return LabelStore(workspace / FILE_NAME, create=False)


def _said_by(who: str, workspace: Path, taxonomy: Path | None) -> list[LabelRecord]:
    """Labels of a file, where there is one of that name, or of an annotator in the store."""
    if Path(who).is_file():
        from tokt.labels.labels import Labels

        return list(Labels.read(who, taxonomy=taxonomy, workspace=workspace))
    from tokt.labels.export import listed
    from tokt.labels.store.store import FILE_NAME

    if not (workspace / FILE_NAME).is_file():
        raise ToktError(f"{who} is not a file, and {workspace} has no label store")
    with _open_store(workspace) as store:
        records = store.current(annotator=who)
        if not records:
            raise ToktError(
                f"{who} is neither a file nor an annotator in {store.path}, which has"
                f" {listed(store.annotators())}"
            )
    return records


def _print_agreement(a: str, b: str, found: Agreement, taxonomy: Path) -> None:
    print(f"A: {a} ({found.n_a} patches)")
    print(f"B: {b} ({found.n_b} patches)")
    print()
    sure, every = str(found.n_both_sure), str(found.n_both)
    with_unsure = (found.kappa_with_unsure, found.agreement_with_unsure)
    summary = [
        ["both sure", sure, _number(found.kappa), _number(found.agreement)],
        ["both, unsure as a class", every, *map(_number, with_unsure)],
    ]
    _print_table(("",), ("patches", "kappa", "equal"), summary)
    print()
    classes = [[name, *_class_cells(entry)] for name, entry in found.per_class.items()]
    classes.append(["obstacle (A sure; B's unsure is none)", *_class_cells(found.obstacle)])
    _print_table(("class",), ("in A", "in B", "in both", "precision", "recall", "F1"), classes)
    print()
    pairs = zip(found.labels, found.confusion, strict=True)
    _print_table(("A \\ B",), found.labels, [[name, *map(str, counts)] for name, counts in pairs])
    for name in found.unknown:
        say(f"note: class {name!r} is not in the taxonomy: add it to {taxonomy}")


def _class_cells(entry: ClassAgreement | None) -> list[str]:
    if entry is None:
        return ["-"] * 6
    shares = (entry.precision, entry.recall, entry.f1)
    return [str(entry.n_a), str(entry.n_b), str(entry.n_both), *map(_number, shares)]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _print_table(texts: Iterable[str], numbers: Iterable[str], rows: Iterable[list[str]]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for name in texts:
        table.add_column(printable(name), no_wrap=True)
    for name in numbers:
        table.add_column(printable(name), justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*map(printable, row))
    # Names are printed as they are, and no number is cut to the width of a terminal.
    Console(markup=False, emoji=False, highlight=False, width=1000).print(table)
