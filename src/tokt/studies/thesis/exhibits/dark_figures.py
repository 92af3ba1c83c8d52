"""Figures 5.6 to 5.8: bad lighting, what a person marks in it, and what every method says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.inference.verdict import CLEAR, STATUS_WORDS
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.exhibit import NOT_KNOWN, Claim, ClaimAgreement, Exhibit, Plot, Table
from tokt.studies.thesis.frame_drawing import (
    DARK_SHOWN,
    draw_dots,
    draw_truth,
    explain_dots,
    png_of,
    show_dark,
    show_mask,
)
from tokt.studies.thesis.methods.all_labels_texture import AllLabelsTexture, train_on_all_labels
from tokt.studies.thesis.methods.curves import OURS, THESIS
from tokt.studies.thesis.methods.dark_rendering import DarkScene
from tokt.studies.thesis.methods.held_out_texture import TOKT_TEXTURE
from tokt.studies.thesis.methods.patch_scores import PatchScore, PatchTruth, score_patches
from tokt.studies.thesis.methods.sequence_methods import TOKT_MODEL

from .dark_picture import DarkPicture, dark_scene, given_picture, rendered_picture
from .dot_figures import score_row, whole_counts
from .picture_predictions import (
    MethodPrediction,
    by_bundle,
    by_stereo,
    by_superpixels,
    by_thesis,
    learnt_words,
    said_by_patches,
)

_LIGHT = 0.125
_LIGHTS = (1.0, 0.5, 0.25, _LIGHT, 0.0625)
"""Of the lamp of a rendered mission; each half of the one before, so one stop."""
_SAYS_CLEAR = "say clear"
_COLORS = {THESIS: "#d9771e", OURS: "#12836f"}


class _Judges:
    """Every method that can judge one picture, made once for all pictures."""

    def __init__(self, context: StudyContext, given: DarkPicture | None) -> None:
        self._context = context
        number = None if given is None else given.number
        self._number = number or 0
        self._whole: AllLabelsTexture | str
        try:
            self._whole = train_on_all_labels(context, number)
        except ToktError as error:
            self._whole = str(error)

    def all(self, dark: DarkPicture, slow: bool = True) -> list[MethodPrediction]:
        """Their predictions of a picture; without `slow` the superpixels are left out."""
        context, frame = self._context, dark.left
        return [
            *by_thesis(context, frame),
            *(by_superpixels(context, self._number, frame) if slow else []),
            self._texture(frame),
            *by_bundle(context, frame, "the model as given"),
            by_stereo(dark.calibration, frame, dark.right, dark.calibration_words),
        ]

    def _texture(self, frame: NDArray[np.uint8]) -> MethodPrediction:
        title = "tokt texture"
        if isinstance(self._whole, str):
            return MethodPrediction(TOKT_TEXTURE, title, OURS, "", None, None, self._whole)
        found = self._whole.judge(frame)
        if isinstance(found, str):
            return MethodPrediction(TOKT_TEXTURE, title, OURS, self._whole.words, None, None, found)
        return said_by_patches(TOKT_TEXTURE, title, OURS, self._whole.words, found, frame)


def bad_lighting(context: StudyContext) -> Exhibit:
    """A badly lit picture, a mask of what is in it, every method's predictions (5.6 to 5.8).

    The picture is that of ``--dark`` with the person's mask of ``--dark-mask``; without it a
    rendered one, whose mask is exact.

    Raises
    ------
    ToktError
        If a file of the request cannot be used.
    """
    given = given_picture(context)
    judges = _Judges(context, given)
    if given is not None:
        return _exhibit(judges.all(given), given, pd.DataFrame())
    scene = dark_scene(context)
    dark = rendered_picture(scene, _LIGHT)
    return _exhibit(judges.all(dark), dark, _sweep(judges, scene))


def _exhibit(said: Sequence[MethodPrediction], dark: DarkPicture, sweep: pd.DataFrame) -> Exhibit:
    truth = dark.truth
    scores = _scores(said, truth)
    plots = [
        Plot(
            "predictions",
            f"{dark.words} (5.6); what is there, {dark.truth_words} (5.7); and what each method "
            f"says (5.8). Green outlines are obstacle patches. {DARK_SHOWN}",
            png_of(_figure(dark, said, truth)),
        )
    ]
    tables = [_score_table(said, scores, dark)]
    if len(sweep):
        plots.append(_sweep_plot(sweep))
        tables.append(
            Table(
                "by-light",
                "F1 by patch of the same rendered scene as the lamp goes down; empty where a "
                "method says that it cannot judge the picture; and who says that it is clear.",
                sweep,
            )
        )
    return Exhibit(
        "figure-5.6-5.8",
        "Bad lighting: a person's eye, and every method's predictions",
        "thesis section 5.3, figures 5.6 to 5.8",
        _words(dark, said),
        _claims(said, scores, dark),
        tuple(tables),
        tuple(plots),
        _numbers(said, scores, dark, sweep),
    )


def _scores(said: Sequence[MethodPrediction], truth: PatchTruth | None) -> dict[str, PatchScore]:
    return {
        one.name: score_patches(one.patches, truth)
        for one in said
        if one.patches is not None and truth is not None
    }


def _score_table(
    said: Sequence[MethodPrediction], scores: dict[str, PatchScore], dark: DarkPicture
) -> Table:
    rows = [
        {
            "method": one.title,
            "whose": one.kind,
            "status": one.status,
            "obstacle patches": None if one.patches is None else int(one.patches.sum()),
            **score_row(scores.get(one.name)),
            "not judged": one.fault,
        }
        for one in said
    ]
    given = any(one.name == TOKT_MODEL for one in said)
    caption = (
        f"By patch, against {dark.truth_words}: an obstacle is what covers a tenth of a patch, "
        "less is not scored. Status is by the mean of the mask alone, without a frame rule. "
        "Counts of patches. Nothing that is trained here learnt from this picture"
        + ("; the model that was given may have." if given else ".")
    )
    return Table("scores", caption, whole_counts(pd.DataFrame(rows)))


def _words(dark: DarkPicture, said: Sequence[MethodPrediction]) -> tuple[str, ...]:
    return (
        f"{dark.words}; {dark.truth_words}. A method that cuts a picture otherwise is scored by "
        "the patches of which its mask has a tenth or more white, as for labels. What could not "
        "judge the picture is not scored as clear.",
        (
            "A rendered picture is another world for models that learnt from a real mission: it "
            "shows the order of things, not figures for the sea. Methods that need the frames "
            "before have nothing to judge here."
            if dark.rendered
            else "Methods that need a pair or the frames before have nothing to judge here."
        ),
        *learnt_words(said),
    )


def _claims(
    said: Sequence[MethodPrediction], scores: dict[str, PatchScore], dark: DarkPicture
) -> tuple[Claim, ...]:
    if not scores or dark.truth is None:
        found = "no mask to score by" if dark.truth is None else "no method judged the picture"
        return (_claim("which method finds most in bad light", found, dark),)
    titles = {one.name: one.title for one in said}
    ranked = sorted(scores, key=lambda name: -(scores[name].f1 or 0.0))
    listed = ", ".join(f"{titles[name]} {scores[name].f1 or 0.0:.2f}" for name in ranked)
    claims = [
        _claim(
            "which method comes nearest to a person in bad light", f"F1 by patch: {listed}", dark
        )
    ]
    if dark.truth.obstacle.any():
        words = [
            f"{status}: {', '.join(who)}"
            for status in STATUS_WORDS.values()
            if (who := [one.title for one in said if one.status == status])
        ]
        what = "what each method says of a picture with an obstacle in it; clear is a wrong clear"
        claims.append(_claim(what, "; ".join(words), dark))
    return tuple(claims)


def _claim(what: str, found: str, dark: DarkPicture) -> Claim:
    why = (
        "The thesis's picture and its person's mask are not at hand; this one is rendered."
        if dark.rendered
        else "The thesis's figures for its picture are not at hand."
    )
    return Claim(what, NOT_KNOWN, found, ClaimAgreement.UNCOMPARABLE, why)


def _figure(
    dark: DarkPicture, said: Sequence[MethodPrediction], truth: PatchTruth | None
) -> Figure:
    n_rows = -(-(3 + len(said)) // 3)
    figure = Figure(figsize=(11.5, 3.05 * n_rows + 0.4), layout="constrained")
    panels = list(figure.subplots(n_rows, 3, squeeze=False).ravel())
    height, width = GRID.resized(*dark.left.shape[:2])
    small = cv2.resize(dark.left, (width, height), interpolation=cv2.INTER_AREA)
    panels[0].imshow(small[..., ::-1] if small.ndim == 3 else small, cmap="gray", vmin=0, vmax=255)
    show_dark(panels[1], dark.left, GRID)
    if dark.mask is not None:
        show_mask(panels[2], dark.mask)
    titles = ["as the camera gives it", "amplified", dark.truth_words]
    for axes, title in zip(panels, titles, strict=False):
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=9, loc="left")
    for axes, one in zip(panels[3:], said, strict=False):
        _panel(axes, dark, one, truth)
    for axes in panels[3 + len(said) :]:
        axes.set_axis_off()
    explain_dots(panels[3 * (n_rows - 1)], truth is not None)
    return figure


def _panel(axes: Any, dark: DarkPicture, one: MethodPrediction, truth: PatchTruth | None) -> None:
    height, width = show_dark(axes, dark.left, GRID)
    if truth is not None:
        draw_truth(axes, truth, GRID, height, width)
    if one.patches is not None:
        draw_dots(axes, one.patches, GRID, height, width)
        title = one.title
        if truth is not None:
            f1 = score_patches(one.patches, truth).f1
            title += "" if f1 is None else f": F1 {f1:.2f}"
    else:
        title = f"{one.title}: not judged"
        axes.text(
            0.5, 0.5, one.fault, transform=axes.transAxes, color="white", fontsize=9, wrap=True,
            ha="center", va="center", bbox={"facecolor": "black", "alpha": 0.7},
        )  # fmt: skip
    axes.set_title(title, fontsize=9, loc="left")


def _sweep(judges: _Judges, scene: DarkScene) -> pd.DataFrame:
    """A row a light, a column a method: F1, or nothing where it was not judged."""
    rows = []
    for light in _LIGHTS:
        dark = rendered_picture(scene, light)
        said = judges.all(dark, slow=False)
        scores = _scores(said, dark.truth)
        wrong = [one.title for one in said if one.status == STATUS_WORDS[CLEAR]]
        grey = float(np.mean(dark.left))
        rows.append(
            {"light": light, "mean grey level": grey}
            | {one.title: scores[one.name].f1 if one.name in scores else None for one in said}
            | {_SAYS_CLEAR: ", ".join(wrong)}
        )
    return pd.DataFrame(rows)


def _methods(sweep: pd.DataFrame) -> list[str]:
    """Titles of the methods in a sweep, which may be empty."""
    known = {"light", "mean grey level", _SAYS_CLEAR}
    return [str(name) for name in sweep.columns if name not in known]


def _sweep_plot(sweep: pd.DataFrame) -> Plot:
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for number, name in enumerate(_methods(sweep)):
        ours = name.startswith("tokt")
        axes.plot(
            sweep["light"], sweep[name].astype(float), marker="osD^v*"[number % 6], label=name,
            color=_COLORS[OURS if ours else THESIS], ls=("-", "--", ":", "-.")[number % 4],
        )  # fmt: skip
    axes.set_xscale("log", base=2)
    axes.invert_xaxis()
    axes.set_xticks(_LIGHTS, [f"{light:g}" for light in _LIGHTS])
    axes.set(xlabel="light of the lamp, of a rendered mission's", ylabel="F1 by patch")
    axes.set_ylim(-0.03, 1.03)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    caption = (
        "The same rendered scene as the lamp goes down, by halves: F1 by patch of the thesis's "
        "methods (orange) and of ours (green). A line ends where the method says that it cannot "
        "judge the picture, which is not clear."
    )
    return Plot("by-light", caption, png_of(figure))


def _numbers(
    said: Sequence[MethodPrediction],
    scores: dict[str, PatchScore],
    dark: DarkPicture,
    sweep: pd.DataFrame,
) -> dict[str, float | int | str | bool]:
    truth = dark.truth
    numbers: dict[str, float | int | str | bool] = {
        "rendered": dark.rendered,
        "mean_grey": float(np.mean(dark.left)),
        "methods": len(said),
        "not_judged": sum(one.patches is None for one in said),
    }
    if truth is not None:
        numbers["obstacle_patches"] = int(truth.obstacle.sum())
        if truth.obstacle.any():
            clear = [one.title for one in said if one.status == STATUS_WORDS[CLEAR]]
            numbers["wrong_clear"] = ", ".join(clear)
    for name, score in scores.items():
        for figure in ("precision", "recall", "f1", "iou"):
            value = getattr(score, figure)
            if value is not None:
                numbers[f"{name}_{figure}"] = value
    for name in _methods(sweep):
        least = sweep.loc[sweep[name].notna() & (sweep[name].astype(float) > 0.5), "light"]
        if len(least):
            numbers[f"least_light_{name}"] = float(least.min())
    return numbers
