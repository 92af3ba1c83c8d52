"""Sentences about a learning curve: would more labels help, and which?"""

from __future__ import annotations

from typing import Any

_SMALL = 0.01  # a gain that is not worth a day of labelling


def learning_words(result: dict[str, Any]) -> list[str]:
    """What a learning curve says, a sentence each.

    Parameters
    ----------
    result : dict
        As `learning_curve` gives it.
    """
    return [*_gain_words(result), *_label_words(result), *_stretch_words(result)]


def _bounds_words(row: dict[str, Any]) -> str:
    if row["low"] is None:
        return ""
    return f" (95 % interval {row['low']:+.3f} to {row['high']:+.3f})"


def _gain_words(result: dict[str, Any]) -> list[str]:
    """The verdict rests on what the last blocks brought: the first ones always help."""
    half, last = result["gains"]
    title = result["measure_title"]
    if last["low"] is None:
        verdict = "Too few blocks to say whether more labels would help"
    elif last["low"] > 0:
        verdict = "More labels of this kind would probably still help"
    elif last["high"] < _SMALL:
        verdict = "More labels of this kind would hardly help"
    else:
        verdict = "Cannot tell whether more labels of this kind would help"
    return [
        f"{verdict}: from three quarters of the blocks to all, {title} changed by "
        f"{last['difference']:+.3f}{_bounds_words(last)}, from half to all by "
        f"{half['difference']:+.3f}{_bounds_words(half)}."
    ]


def _label_words(result: dict[str, Any]) -> list[str]:
    rows = [row for row in result["by_label"] if row["n"]]
    worst = max(rows, key=lambda row: row["wrong"][-1])
    half = [point["fraction"] for point in result["points"]].index(0.5)
    gains = {row["label"]: row["wrong"][half] - row["wrong"][-1] for row in rows}
    most = max(gains, key=lambda label: gains[label])
    said = (
        f"By class: {worst['label']} is judged wrong most often ({worst['wrong'][-1]:.1%} of "
        f"{worst['n']} patches)"
    )
    if gains[most] > 0:
        said += (
            f"; the second half of the blocks helped {most} most (its share judged wrong fell by "
            f"{100 * gains[most]:.1f} percentage points)"
        )
    return [f"{said}."]


def _stretch_words(result: dict[str, Any]) -> list[str]:
    rows = result["stretches"]
    if not rows:
        return []
    best, least = rows[0], rows[-1]
    words = [
        f"By stretch: frames {best['frames']} of {best['mission']} ({best['obstacle']} obstacle "
        f"patches) helped the other blocks most: with them {result['measure_title']} is "
        f"{best['help']:+.3f} from what it is without{_bounds_words(best)}."
    ]
    if best["low"] is None or best["low"] <= 0:
        words.append(f"Of {len(rows)} stretches none helps beyond doubt; their order may be luck.")
    if least["high"] is not None and least["high"] < 0:
        words.append(
            f"Learning from frames {least['frames']} of {least['mission']} made the other blocks "
            f"worse by {-least['help']:.3f}{_bounds_words(least)}: they look unlike the rest, or "
            "their labels are worth a second look."
        )
    return words
