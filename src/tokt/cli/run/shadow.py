"""``tokt shadow``: how a challenger compared with the running model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tokt.cli.options import JsonOption
from tokt.cli.output import print_json

if TYPE_CHECKING:
    from tokt.inference.replay.shadow_report import ShadowReport, ShadowStretch

_MAX_SHOWN = 40


def shadow(
    log: Annotated[Path, typer.Argument(help="The file of `tokt run --shadow-log`.")],
    run: Annotated[
        str | None, typer.Option("--run", help="Which run of the log. Default: its last.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Show where a challenger and the running model said otherwise on the same frames."""
    from tokt.inference.replay.shadow_report import read_shadow

    report = read_shadow(log, run)
    if json:
        print_json(report.to_json())
    else:
        _show(report)


def _show(report: ShadowReport) -> None:
    champions = ", ".join(report.champions) or "no model"
    print(f"run {report.run}, policy {report.policy}")
    print(f"champion {champions}, challenger {report.challenger['label']} (never sent)")
    words = list(report.table())
    print("\n" + f"{'champion':>10}   challenger: " + "".join(f"{word:>10}" for word in words))
    for word, row in report.table().items():
        print(f"{word:>10}" + " " * 15 + "".join(f"{row[other]:>10}" for other in words))
    share = f" ({100 * report.agree / report.frames:.1f} %)" if report.frames else ""
    print(f"\n{report.frames} frames compared: one status on {report.agree}{share}")
    print(f"{report.dropped} frames left out: the challenger was busy, or not ready yet")
    for side in ("champion", "challenger"):
        _show_side(report, side)
    leads = report.lead_frames()
    if leads:
        earlier, later = sum(lead > 0 for lead in leads), sum(lead < 0 for lead in leads)
        print(
            f"of the champion's {len(leads)} shared episodes the challenger begins earlier in "
            f"{earlier}, later in {later}, at the same frame in {len(leads) - earlier - later}"
        )
    if report.fault:
        print(f"the challenger judged no more: {report.fault}")
    if report.lost_lines:
        print(f"{report.lost_lines} places of the log cannot be read")
    for stretch in report.stretches[:_MAX_SHOWN]:
        print(_stretch_line(stretch))
    if len(report.stretches) > _MAX_SHOWN:
        print(f"... and {len(report.stretches) - _MAX_SHOWN} more stretches (--json has all)")
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
        f"{side}: obstacle alone on {frames} frames in {stretches} stretches; {episodes} episodes, "
        f"{shared} shared; unknown on {report.unknown(side)} frames; {took}"
    )


def _stretch_line(stretch: ShadowStretch) -> str:
    said = stretch.to_json()
    frames = f"{stretch.first}"
    if stretch.frames > 1:
        frames += f"-{stretch.last} ({stretch.frames} frames)"
    return f"frame {frames}: champion {said['champion']}, challenger {said['challenger']}"
