"""`tokt replay`, `tokt findings`, `tokt shadow`: what a run's log tells, by itself or anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tokt.features.common.errors import ToktError, counted
from tokt.features.common.terminal import say

from .options import JsonOption, LoggedRunOption
from .output import answer, progress
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.inference.policy.assembly import StereoSetup
    from tokt.inference.replay.findings import InspectionFinding
    from tokt.inference.replay.logged_run import LoggedRun
    from tokt.inference.replay.mcap_file import Exported
    from tokt.inference.replay.replay import Replay, ReplayStretch, Tally
    from tokt.inference.replay.shadow_report import ShadowReport, ShadowStretch

DIFFERENT = 1
"""Exit code where a verdict or a picture is not what it was."""
_MAX_SHOWN = 40


def replay(
    log: Annotated[Path, Argument(metavar="LOG", help="Log of `tokt run`, or a recording.")],
    bundle: Annotated[
        Path | None,
        Option(
            metavar="FILE|STORE",
            help="Judge with this model, or with a store's active one, instead of the run's own.",
        ),
    ] = None,
    store: Annotated[
        Path | None, Option(help="Store that has the run's own models. Default: the run's.")
    ] = None,
    source: Annotated[
        Path | None,
        Option(
            help="Mission or recording that has the pictures. Default: the recording itself, or "
            "the log's source or recording."
        ),
    ] = None,
    calibration: Annotated[
        Path | None, Option(help="Stereo calibration file. Default: the log's, unchanged.")
    ] = None,
    run: Annotated[
        str | None,
        Option(help="Run of the log, by its ID. Default: the last one; with --export, all."),
    ] = None,
    export: Annotated[
        Path | None,
        Option(
            metavar="FILE.mcap|FILE.csv",
            help="Judge nothing: write the log for a spreadsheet (.csv), or with the judged "
            "pictures for Foxglove and ROS 2 (.mcap).",
        ),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Judge a logged run's frames again; show where verdicts differ.

    Exit code 0: each verdict is the same to the last bit. 1: a verdict or a picture is not. 2: the
    run cannot be judged again.
    """
    from tokt.inference.replay.logged_run import open_run
    from tokt.inference.replay.replay import Replay, Tally, model_named, models_of_run, pictures_of

    if export is not None:
        if bundle is not None or calibration is not None:
            raise ToktError("--export judges nothing: leave out --bundle and --calibration")
        if export.suffix.lower() == ".csv" and (source is not None or store is not None):
            raise ToktError("a CSV file has no pictures or patches: leave out --source and --store")
        from tokt.inference.replay.export import export_log

        shown = partial(progress, what="exported")
        done = export_log(log, export, run, source, store, shown)
        for note in done.notes:
            say(f"note: {note}")
        answer(json, {"file": str(export), **vars(done)}, lambda: _show_export(export, done))
        return 0
    logged = open_run(log, run)
    mission, pixel_format = pictures_of(log, logged.run, logged.start, source)
    stereo = _stereo(logged, calibration)
    other = None if bundle is None else model_named(bundle)
    if other is not None and [name.sha256 for name in logged.models] == [other.sha256]:
        models, other = {other.sha256: other}, None  # the run's own
    else:
        models = {} if other is not None else models_of_run(logged, store)
    plan = Replay(logged, mission, pixel_format, stereo, models, other)
    warnings = _software_warnings(logged)
    if run is None and logged.others:
        warnings.append(
            f"only the log's last run is judged again, not the {len(logged.others)} before it "
            f"(--run ID; the one before is {logged.others[-1]})"
        )
    for warning in warnings:
        say(f"note: {warning}")
    tally = Tally()
    for frame in progress(plan.frames(), logged.n_frames, "judged again"):
        tally.add(frame)
    if not tally.compared:
        why_not = tally.not_compared.items()
        reasons = ", ".join(f"{counted(n, 'frame')}: {why}" for why, n in why_not)
        raise ToktError(f"no frame of run {logged.run} can be compared ({reasons or 'no frames'})")
    by = other.label if other is not None else "the run's own"
    about = {"run": logged.run, "frames": logged.n_frames, "model": by, "notes": warnings}
    answer(json, {**about, **tally.to_json()}, lambda: _show_replay(plan, tally, by))
    return 0 if tally.agrees else DIFFERENT


def findings(
    logs: Annotated[list[Path], Argument(metavar="LOG...", help="Logs of `tokt run`.")],
    output: Annotated[
        Path,
        Option("--output", "-o", metavar="FILE", help="File to write: .geojson, .csv or .html."),
    ],
    classes: Annotated[
        str | None,
        Option(
            help="Classes to look for, separated by commas. Default: those in at most half of the "
            "frames."
        ),
    ] = None,
    ahead: Annotated[
        float,
        Option(
            metavar="METRES",
            help="How far ahead of the vehicle's position the middle of the picture looks.",
        ),
    ] = 0.0,
    min_frames: Annotated[
        int, Option(help="Frames in which a thing must be seen to be a finding.", min=1)
    ] = 3,
    min_patches: Annotated[
        int, Option(help="Patches that it must have in its best picture.", min=1)
    ] = 3,
    odometry: Annotated[
        Path | None,
        Option(help="Poses by frame (CSV) for the way along the track. Default: the run's own."),
    ] = None,
    source: Annotated[
        Path | None, Option(help="Mission that has the pictures. Default: the log's source.")
    ] = None,
    store: Annotated[
        Path | None, Option(help="Store that has the run's own models. Default: the run's.")
    ] = None,
    run: LoggedRunOption = None,
    json: JsonOption = False,
) -> None:
    """Group what logs show into findings.

    Each has its class, its frames, its best picture, its place and a confidence. Review them with
    `tokt label --findings`.
    """
    from tokt.inference.replay.findings import find, rare_classes
    from tokt.inference.replay.findings_file import ENDINGS, HTML, write_findings
    from tokt.inference.replay.logged_track import open_track
    from tokt.inference.stereo.odometry import load_odometry

    if (ending := output.suffix.lower()) not in ENDINGS:
        raise ToktError(f"findings are written as {', '.join(ENDINGS)}, not {output.name}")
    if len(logs) > 1 and (run, source, odometry) != (None, None, None):
        raise ToktError("--run, --source and --odometry are of one log: name just one")
    chosen = None if classes is None else [name.strip() for name in classes.split(",")]
    poses = None if odometry is None else load_odometry(odometry)
    tracks = [open_track(log, run, source, store, poses) for log in logs]
    for track in tracks:
        if track.damaged:
            say(f"note: {track.log}: {counted(track.damaged, 'damaged line')} left out")
    found = [it for track in tracks for it in find(track, chosen, ahead, min_frames, min_patches)]
    if ending == HTML:
        from tokt.training.findings.report import write_findings_page

        named = chosen or sorted({name for track in tracks for name in rare_classes(track)})
        write_findings_page(output, found, {track.run: track.mission for track in tracks}, named)
    else:
        write_findings(output, found)
    value = {"file": str(output), "findings": [it.to_json()["properties"] for it in found]}
    answer(json, value, lambda: _show_findings(output, found))


def _show_findings(output: Path, found: Sequence[InspectionFinding]) -> None:
    for number, it in enumerate(found, 1):
        place = "" if it.along_m is None else f", {it.along_m:.1f} m along"
        frames = f"frames {it.first_frame} to {it.last_frame}"
        print(f"{number}: {it.label}, {frames}{place}, confidence {it.confidence:.2f}")
    print(f"{output}: {counted(len(found), 'finding')}")


def _show_export(target: Path, done: Exported) -> None:
    print(f"{target}: {done.frames} frames, {done.heartbeats} heartbeats, {done.events} events")
    if done.damaged:
        print(f"{done.damaged} places of the log cannot be read and are left out")
    if done.untimed:
        print(f"{done.untimed} lines left out: they have no time")
    if done.with_picture or done.no_picture:
        print(f"{done.with_picture} frames with pictures, {sum(done.no_picture.values())} without")
    for why, count in done.no_picture.items():
        print(f"  {count}: {why}")


def _stereo(logged: LoggedRun, calibration: Path | None) -> StereoSetup | None:
    """How the run looked at pairs; with another calibration only where one is named."""
    from tokt.inference.policy.assembly import StereoSetup
    from tokt.inference.recording.run_start import used_file
    from tokt.inference.replay.replay import odometry_of

    start = logged.start
    if start.calibration is None or start.stereo_way is None or start.stereo_scale is None:
        if calibration is not None:
            raise ToktError("the run had no calibration: leave out --calibration")
        return None
    path = calibration or Path(start.calibration.path)
    if not path.is_file():
        raise ToktError(f"the run's calibration {path} is not there (--calibration FILE)")
    if used_file(path).sha256 != start.calibration.sha256:
        different = f"calibration {path} is not the one that the run had"
        if calibration is None:
            raise ToktError(f"{different} (--calibration {path} takes it all the same)")
        say(f"note: {different}")
    # A run of earlier versions may have had a calibration of any form.
    from tokt.training.calibration.any_form import read_calibration_file

    return StereoSetup(
        read_calibration_file(path, say), start.stereo_way, start.stereo_scale, odometry_of(start)
    )


def _software_warnings(logged: LoggedRun) -> list[str]:
    """What computed the verdicts then and is another now."""
    from tokt.inference.recording.run_start import software

    then = logged.start.software
    return [
        f"the run had {name} {then.get(name, '(not told)')}, here is {now}"
        for name, now in software().items()
        if then.get(name) != now
    ]


def _show_replay(plan: Replay, tally: Tally, by: str) -> None:
    logged = plan.run
    names = ", ".join(name.label for name in logged.models) or "no model"
    frames = counted(logged.n_frames, "frame")
    print(f"run {logged.run}: {frames}, policy {logged.start.policy}, {names}")
    print(f"judged again by: {by}")
    _show_table("logged", "judged again", tally.statuses)
    if tally.compared == tally.same:
        print(f"all {tally.compared} frames compared are the same, to the last bit")
    else:
        print(
            f"{counted(tally.compared, 'frame')} compared: {tally.same} the same to the last bit, "
            f"{tally.status_differs} with another status, {tally.figures_differ} with the same "
            "status and another figure"
        )
    for why, count in tally.not_compared.items():
        print(f"{counted(count, 'frame')} not compared: {why}")
    if tally.alike_all_the_same:
        print(f"  ({tally.alike_all_the_same} of them came out the same)")
    if tally.gaps:
        what = "frames that were not recorded" if logged.recorded else "lines that are lost"
        print(f"in {counted(tally.gaps, 'place')}: {what}, which are in no figure here")
    _show_stretches(tally.stretches, _replayed_words)


def _replayed_words(stretch: ReplayStretch) -> str:
    value: dict[str, Any] = stretch.to_json()
    then, now = (
        f"{value[side]['status']} ({value[side]['reason']})" for side in ("logged", "replayed")
    )
    changes = "; ".join(
        f"{name} {was!r} -> {became!r}"
        for name, (was, became) in stretch.example.items()
        if name not in ("status", "reason")
    )
    return f"{then} -> {now}; {changes or ', '.join(stretch.fields)}"


def shadow(
    log: Annotated[Path, Argument(metavar="LOG", help="Log of `tokt run --shadow-log`.")],
    run: LoggedRunOption = None,
    json: JsonOption = False,
) -> None:
    """Show where a challenger and the running model differ."""
    from tokt.inference.replay.shadow_report import read_shadow

    report = read_shadow(log, run)
    answer(json, report.to_json(), lambda: _show_shadow(report))


def _show_shadow(report: ShadowReport) -> None:
    champions = ", ".join(report.champions) or "no model"
    print(f"run {report.run}, policy {report.policy}")
    print(f"champion {champions}, challenger {report.challenger['label']} (never sent)")
    _show_table("champion", "challenger", report.statuses)
    share = f" ({100 * report.agree / report.frames:.1f} %)" if report.frames else ""
    print(f"{counted(report.frames, 'frame')} compared: one status on {report.agree}{share}")
    print(f"{counted(report.dropped, 'frame')} left out: the challenger was busy, or not ready yet")
    for side in ("champion", "challenger"):
        _show_side(report, side)
    leads = report.lead_frames()
    if leads:
        earlier, later = sum(lead > 0 for lead in leads), sum(lead < 0 for lead in leads)
        print(
            f"of the champion's {counted(len(leads), 'shared episode')} the challenger begins "
            f"earlier in {earlier}, later in {later}, "
            f"at the same frame in {len(leads) - earlier - later}"
        )
    if report.fault:
        print(f"the challenger judged no more: {report.fault}")
    if report.lost_lines:
        print(f"{counted(report.lost_lines, 'place')} of the log cannot be read")
    _show_stretches(
        report.stretches,
        lambda one: "champion {champion}, challenger {challenger}".format(**one.to_json()),
    )
    print(
        "Frames that follow each other show almost the same: go by stretches and episodes. Which "
        "of the two is right is not known here; labels can tell (tokt label, tokt evaluate)."
    )


def _show_side(report: ShadowReport, side: str) -> None:
    frames, stretches = report.alone(side)
    episodes, shared = len(report.episodes[side]), len(report.shared_episodes(side))
    latency = report.latency(side)
    took = (
        "no latency"
        if latency is None
        else f"{latency['median']:.1f} ms median, {latency['p99']:.1f} ms p99"
    )
    print(
        f"{side}: obstacle alone on {counted(frames, 'frame')} in {counted(stretches, 'stretch')}; "
        f"{counted(episodes, 'episode')}, {shared} shared; "
        f"unknown on {counted(report.unknown(side), 'frame')}; {took}"
    )


def _show_table(rows: str, columns: str, statuses: Counter[tuple[int, int]]) -> None:
    """Frames by what either side said of them."""
    from tokt.inference.verdict import status_table

    table = status_table(statuses)
    left = f"{rows:>10}   {columns}: "
    print()
    print(left + "".join(f"{word:>10}" for word in table))
    for word, row in table.items():
        print(f"{word:>10}".ljust(len(left)) + "".join(f"{row[other]:>10}" for other in table))
    print()


def _show_stretches(
    stretches: Sequence[ReplayStretch] | Sequence[ShadowStretch], words: Callable[[Any], str]
) -> None:
    """The first of them, and what either side said of their frames."""
    for stretch in stretches[:_MAX_SHOWN]:
        frames = f"{stretch.first}"
        if stretch.frames > 1:
            frames += f"-{stretch.last} ({stretch.frames} frames)"
        print(f"frame {frames}: {words(stretch)}")
    if len(stretches) > _MAX_SHOWN:
        print(f"... and {len(stretches) - _MAX_SHOWN} more stretches (--json has all)")
