"""The bench's results as a table and as a bar chart."""

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tokt.training.evaluation.pictures import figure_png, new_figure

from .paired_timing import Result

_PLAIN_WIDTH = 170
_SAME, _DIFFERENT, _FLOOR = "#3b75af", "#c44e52", "#dd8452"
_DPI = 130
_TICKS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000)
_ROOM = 1.12
"""Axis length over that of the longest bar, both in decades: room for the figure at its end."""
_FIGURE_WIDTH = 0.08
"""Of the axis, taken by the figure at a bar's end and a marker beside it."""
_MIN_FLOOR = 0.05
"""Of our time; a floor below limits nothing, and its marker would only press the bars together."""
_FLOOR_LABEL = "where the bar would end if tokt took no more time than the floor"


def _duration(milliseconds: float) -> str:
    if milliseconds >= 1000:
        return f"{milliseconds / 1000:.3g} s"
    return f"{milliseconds:.3g} ms" if milliseconds >= 1 else f"{milliseconds * 1000:.3g} µs"


def _times(case: Result) -> str:
    """What stands at the right of a case."""
    text = f"{_duration(case.baseline_ms)} to {_duration(case.ours_ms)}"
    mine, theirs = case.extras.get("ours_mb"), case.extras.get("baseline_mb")
    if mine and theirs:
        text += f"\n{theirs:.0f} MB to {mine:.0f} MB"
    return text if case.exact else f"{text}\nNOT EXACT"


def _name(case: Result) -> str:
    """What stands at the left of a case; most are tokt against others, some are not."""
    against_tokt = str(case.extras.get("baseline_is", "")).startswith("tokt itself")
    return f"{case.name}\n(tokt itself)" if against_tokt else case.name


def _floor_ratio(case: Result) -> float | None:
    """The ratio if ours took no more than the floor; None where that says nothing."""
    floor = case.extras.get("floor_ms")
    if floor is None or not _MIN_FLOOR * case.ours_ms <= floor < case.ours_ms:
        return None
    return case.baseline_ms / float(floor)


def chart_png(results: Sequence[Result], about: Mapping[str, Any]) -> bytes:
    """A PNG file: ratios on a log axis, whiskers for the spread; `about` as in the bench's JSON."""
    figure, axes = new_figure(10.5, 2.1 + 0.42 * len(results))
    longest = max(max(*case.spread, _floor_ratio(case) or 0.0, 1.0) for case in results)
    left = min(0.9, *(case.spread[0] * 0.8 for case in results))
    right = left * (longest / left) ** _ROOM
    _draw(axes, results, left, right)
    _dress(axes, results, left, right)
    kernels, machine = about["kernels"], about["machine"]
    figure.suptitle(
        f"tokt ({kernels['name']} kernels{', ARE the libraries' if kernels['is_library'] else ''}) "
        "against scikit-image, mahotas and the thesis's pipeline"
    )
    words = f"mission {about['mission']}, {about['frame_size']}; {machine['cpu']}"
    threads = f"one thread of {machine['cores']} core(s), but for all_cores and start"
    axes.set_title(f"{words}; {threads}", fontsize=8, color="0.35")
    if any(_floor_ratio(case) for case in results):
        figure.legend(loc="outside lower right", fontsize=8, frameon=False)
    return figure_png(figure, _DPI)


def _draw(axes: Any, results: Sequence[Result], left: float, right: float) -> None:
    """Bars, whiskers, floors, and the figures at their ends."""
    label: str | None = _FLOOR_LABEL
    for place, case in enumerate(results):
        color = _SAME if case.exact else _DIFFERENT
        axes.barh(place, case.ratio - left, left=left, color=color, height=0.62)
        axes.plot(case.spread, [place, place], "-|", color="black", lw=1.2, ms=7)
        end, floor = max(*case.spread, case.ratio), _floor_ratio(case)
        if floor is not None:
            axes.plot(floor, place, "D", color=_FLOOR, ms=5, label=label)
            label = None
            # The figure would lie on the marker.
            if abs(np.log(floor / end) / np.log(right / left)) < _FIGURE_WIDTH:
                end = max(end, floor)
        beside: Any = {"textcoords": "offset points", "va": "center", "fontweight": "bold"}
        axes.annotate(f"{case.ratio:.3g}x", (end, place), (8, 0), **beside)


def _dress(axes: Any, results: Sequence[Result], left: float, right: float) -> None:
    """Both axes, and the times at the right."""
    axes.axvline(1.0, color="0.3", lw=0.9, ls=":")
    axes.set_xscale("log")
    axes.set_xlim(left, right)
    axes.set_xticks([tick for tick in _TICKS if left <= tick <= right])
    axes.set_xticks([], minor=True)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlabel("times faster (bar: medians; whisker: 10th to 90th percentile)")
    axes.grid(axis="x", alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_yticks(range(len(results)), [_name(case) for case in results])
    axes.set_ylim(len(results) - 0.4, -0.6)
    times = axes.secondary_yaxis("right")
    times.set_yticks(range(len(results)), [_times(case) for case in results], fontsize=9)
    times.tick_params(length=0)
    times.spines["right"].set_visible(False)


def _figure(value: float) -> str:
    return f"{value:.3f}" if value < 10 else f"{value:.1f}"


_REMARKS = {
    "baseline_patches_per_s": "{baseline_patches_per_s:,.0f} to {ours_patches_per_s:,.0f} "
    "patches a second, {processes} process(es)",
    "ours_mb": "peak memory {baseline_mb:.0f} MB to {ours_mb:.0f} MB",
    "pictures_checked": "ours against ours: {baseline_is} against this preset ({features} "
    "features; pictures alone {floor_ms} ms); asked: {asked}",
    "max_relative_difference": "largest relative difference {max_relative_difference:.1g}",
    "obstacle_patches": "{frames_checked} frames compared, {obstacle_patches} obstacle patches"
    "{refused}{tied}; baseline the thesis's way, libraries used well {libraries_ms} ms",
    "patches_checked": "{patches_checked} patches compared",
    "not_the_detector_median_ms": "{of}: p99 {ours_p99_ms}, longest {ours_max_ms} ms; of it not "
    "the detector: median {not_the_detector_median_ms}, p99 {not_the_detector_p99_ms} ms",
    "of": "{of}",
}
"""What a case has to say besides its times, by a figure that it has; the first counts."""


def _remark(case: Result) -> str:
    extras = {key: value for key, value in case.extras.items() if value is not None}
    if "pairs_checked" in extras:
        return _stereo_remark(extras)
    if case.extras.get("max_relative_difference", 0) is None:
        return "not finite"
    words = next(words for key, words in _REMARKS.items() if key in extras)
    shown = {key: _figure(value) for key, value in extras.items() if key.endswith("_ms")}
    frames, ties = extras.get("frames_refused"), extras.get("ties")
    refused = f", {frames} refused" if frames else ""
    return words.format_map(
        {**extras, **shown, "refused": refused, "tied": f", {ties} ties" if ties else ""}
    )


def _stereo_remark(extras: Mapping[str, Any]) -> str:
    """The obstacles of both ways, the times of pairs with and without one, and what is exact."""
    seen, count = extras["obstacle_pairs"], extras["pairs_checked"]
    parts = [f"obstacle in {seen['baseline']} (thesis) and {seen['ours']} (ours) of {count} pairs"]
    for key in ("with_obstacle", "without_obstacle"):
        if kind := extras.get(key):
            times = f"{_figure(kind['baseline_ms'])} to {_figure(kind['ours_ms'])} ms"
            parts.append(f"{key.replace('_', ' ')}: {times}, {kind['ratio']:.3g}x")
    parts.append(f"exact: {extras['exact_is']}")
    return "; ".join(parts)


def print_table(results: Sequence[Result], about: Mapping[str, Any]) -> None:
    """Print the results on standard output, as wide as the terminal or as plain text."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("case", no_wrap=True)
    for heading in ("baseline ms", "tokt ms", "ratio", "spread", "floor ms", "exact"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for case in results:
        floor = case.extras.get("floor_ms")
        table.add_row(
            case.name,
            _figure(case.baseline_ms),
            _figure(case.ours_ms),
            f"{case.ratio:.3g}x",
            f"{case.spread[0]:.3g}-{case.spread[1]:.3g}",
            "" if floor is None else _figure(floor),
            "yes" if case.exact else "NO",
            _remark(case),
        )
    console.print(table)
    for line in about_lines(about):
        console.print(line, markup=False)


def about_lines(about: Mapping[str, Any]) -> list[str]:
    """What was measured on what, in sentences."""
    machine, kernels = about["machine"], about["kernels"]
    versions = ", ".join(
        f"{name} {machine[name]}"
        for name in ("python", "numpy", "opencv", "scikit-image", "mahotas", "scikit-learn")
    )
    lines = [
        f"kernels: {kernels['name']} ({kernels['why']})",
        f"mission: {about['mission']}, frames of {about['frame_size']}; "
        f"{about['frames']['compared']} compared, {about['frames']['timed']} timed",
        f"stereo: {about['stereo']}",
        f"model: {about['model']}. A figure of speed only: nothing is said of accuracy.",
        f"spread: {about['spread_is']}",
        f"machine: {machine['cpu']}, {machine['cores']} core(s); {versions}",
    ]
    if video := about["video_mb"]:
        figures = ", ".join(f"{form} {mb:.0f} MB" for form, mb in video.items())
        lines.append(
            f"peak of what a run with video in allocates, all processes together: {figures}"
        )
    if kernels["is_library"]:
        lines.insert(1, "these kernels ARE the libraries: a kernel's ratio is about 1 by nature")
    return lines
