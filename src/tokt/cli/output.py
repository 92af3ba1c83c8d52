"""The results of a command on its terminal: lines, figures and progress."""

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from tokt.features.common.errors import printable
from tokt.features.common.terminal import print_json, say

T = TypeVar("T")
_MAX_SILENCE_S = 30.0


def print_line(text: str = "") -> None:
    """Print a line for people on standard output, `printable` whatever file it comes from.

    The modules of this room import it as ``print``.
    """
    print(printable(text), flush=True)  # somebody may wait for it


def answer(as_json: bool, value: Any, show: Callable[[], object]) -> None:
    """Print a command's result: as a JSON object where that is asked for, else as `show` does."""
    if as_json:
        print_json(value)
    else:
        show()


def progress(items: Iterable[T], total: int, what: str) -> Iterator[T]:
    """Yield `items`, showing how far it is and how long it will take.

    A bar on a terminal; elsewhere a line each quarter, and at least every half minute.
    """
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import track

        yield from track(items, what, total, console=Console(stderr=True), transient=True)
        return
    step = max(1, total // 4)
    began = said = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if done % step == 0 or done == total or now - said > _MAX_SILENCE_S:
            said = now
            say(f"{what}: {done}/{total}{_remaining((now - began) / done * (total - done))}")


def _remaining(seconds: float) -> str:
    """A rough time to go, where it is long enough to matter."""
    if seconds < _MAX_SILENCE_S:
        return ""
    minutes = math.ceil(seconds / 60)
    if minutes < 120:
        return f", about {minutes} min left"
    return f", about {math.ceil(minutes / 60)} h left"


def print_patches(patch: dict[str, Any]) -> None:
    """Obstacle figures where they mean something, and those by class for several classes."""
    if patch["f1"] is not None:
        print_line(f"  obstacle patches: {scores(patch)}")
    if patch["f1"] is None or len(patch["per_class"]) > 2:
        by_class = ", ".join(
            f"{name} {figure(row['f1'])}" for name, row in patch["per_class"].items()
        )
        print_line(f"  classes: macro-F1 {figure(patch['macro_f1'])} ({by_class})")


def unseen_in_words(unseen: dict[str, Any]) -> str:
    """How many labelled frames a run would not call clear."""
    count = sum(unseen["reasons"].values())
    which = "; ".join(f"{mission} {frames}" for mission, frames in unseen["which"].items())
    return (
        f"a run would call {count} of the {unseen['frames']} labelled frames unknown where it "
        f"finds no obstacle{f' ({which})' if which else ''}"
    )


def scores(patch: dict[str, Any], between: str = "") -> str:
    """The figures of obstacle patches; `between` follows F1."""
    f1, precision, recall, average = (
        figure(patch[key]) for key in ("f1", "precision", "recall", "average_precision")
    )
    return f"F1 {f1}{between}, precision {precision}, recall {recall}, AP {average}"


def figure(value: float | None) -> str:
    """A figure with three decimals, or ``-`` where it is undefined."""
    return "-" if value is None else f"{value:.3f}"


def print_at_sea(frames: dict[str, Any], indent: str) -> None:
    """Print false statuses an hour, and what is left at each approach's first status."""
    hourly = frames["false_status_per_hour"]
    if hourly:
        bound, rate = hourly["upper_bound"], hourly["rate_fps"]
        per = "in 1,000 frames" if rate is None else f"an hour at {rate:.3g} frames a second"
        counts = hourly["false_status"], bound["of_frames"], bound["of_blocks"], bound["blocks"]
        seen, most, some, blocks = (f"{one:.0f}" if one >= 100 else f"{one:.3g}" for one in counts)
        print_line(
            f"{indent}false statuses {per} of open ocean: {seen}; with {bound['confidence']:.0%} "
            f"confidence at most {most}, were frames independent. At most {some} of {blocks} "
            "blocks of near copies have one"
        )
    for one in frames["approaches"]:
        print_line(f"{indent}{_approach(one)}")
    if not frames["approaches"]:
        print_line(f"{indent}no approach in the labels: no obstacle frame after an ocean frame")


def _approach(one: dict[str, Any]) -> str:
    where = f"{one['mission']}:" if "mission" in one else ""
    words = f"approach {where}{one['first_obstacle_frame']}-{one['last_obstacle_frame']}: "
    if one["first_status"] is None:
        return f"{words}NO STATUS"
    late = one["frames_late"]
    words += f"first status {one['first_status']}, {late} frame{'s' * (late != 1)} late"
    if one["distance_m"] is not None:
        words += f", {one['distance_m']:.2f} m away"
        if one["distance_frame"] != one["first_status"]:
            words += f" in frame {one['distance_frame']}"
        if one["contact_s"] is not None:
            words += f", contact in {one['contact_s']:.1f} s at {one['closing_m_s']:.2f} m/s"
    if one["stopping_distance_m"] is None:
        return words
    said = {True: "enough", False: "TOO LATE", None: "not measured, not judged"}[one["enough"]]
    return f"{words}; {said} for a stopping distance of {one['stopping_distance_m']:g} m"
