"""Figures 5.6 to 5.8: bad lighting, what a person marks in it, and what every method says."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import read_image
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.verdict import CLEAR, STATUS_WORDS
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.simulation.rendering.lighting import expose
from tokt.studies.simulation.rendering.raycast import View
from tokt.studies.simulation.rendering.sensor import develop
from tokt.studies.simulation.rendering.synthetic_mission import MissionScene
from tokt.studies.simulation.scene.rig import FULL_WIDTH
from tokt.studies.simulation.scene.water import CameraResponse, Water
from tokt.studies.thesis.methods.curves import OURS, THESIS, learnt_words
from tokt.studies.thesis.methods.mission_models import TOKT_TEXTURE, JudgeFrame, train_on_all_labels
from tokt.studies.thesis.patch_scores import Truth, truth_by_mask

from .dot_figures import (
    MethodPrediction,
    by_bundle,
    by_stereo,
    by_superpixels,
    by_thesis,
    may_have_learnt,
    said_by_patches,
    scored_predictions,
)
from .exhibit import NOT_KNOWN, Claim, Exhibit, Plot, StudyContext, Table
from .frame_drawing import (
    DARK_SHOWN,
    draw_dots,
    draw_truth,
    explain_dots,
    new_figure,
    png_of,
    show_dark,
    show_mask,
)

SEED = 8
RENDERED_WIDTHS = (360, FULL_WIDTH)
"""Least and largest width in pixels of a picture; the methods look at 360."""
_FRAMES = 40
_PLACE = 27
"""The 28th of 40 frames: the tower is about three metres away and fills a part of the picture."""
_MOMENT, _SENSOR = 0, 1
_LIGHT = 0.125
_LIGHTS = (1.0, 0.5, 0.25, _LIGHT, 0.0625)
"""Of the lamp of a rendered mission; each half of the one before, so one stop."""
_SAYS_CLEAR = "say clear"
_COLORS = {THESIS: "#d9771e", OURS: "#12836f"}

Said = Sequence[MethodPrediction]
Texture = tuple[str, JudgeFrame]


@dataclass(frozen=True)
class DarkPicture:
    """A picture, its right one where there is one, and what is in it.

    The mask, white where the obstacle is, is what is shown, the truth by patch what is scored;
    both are None where nobody marked the picture. Words say what the picture is, whose the truth
    is, and where the calibration is from; `number` is of the mission's frame it is, if it is one.
    """

    left: U8
    right: U8 | None
    mask: U8 | None
    truth: Truth | None
    calibration: StereoCalibration | None
    words: str
    truth_words: str
    calibration_words: str
    rendered: bool = False
    number: int | None = None


def given_picture(context: StudyContext) -> DarkPicture | None:
    """The image of ``--dark`` and the mask of ``--dark-mask``; None where no image was given.

    An image that is a frame of the mission has a right picture, and labels that stand in for a
    mask. Raises ToktError if a file cannot be read, or the mask is of another size than the image.
    """
    file = context.request.dark
    if file is None:
        return None
    left, number = read_image(file), context.frame_with(file)
    words, right = f"The image {file.name}", None
    if number is not None:
        words += f", which is the mission's frame {number}"
        right = context.right(number)
    calibration, calibration_words = None, ""
    if right is not None:
        calibration, calibration_words = context.calibration, context.calibration_words
    mask, truth, truth_words = _truth(context, left, number)
    return DarkPicture(
        left, right, mask, truth, calibration, words, truth_words, calibration_words, number=number
    )


def _truth(
    context: StudyContext, left: U8, number: int | None
) -> tuple[U8 | None, Truth | None, str]:
    """A mask to show, the truth by patch, and whose it is."""
    file = context.request.dark_mask
    if file is not None:
        mask = read_image(file)
        if mask.ndim == 3:
            mask = np.asarray(cv2.cvtColor(mask, cv2.COLOR_BGR2GRAY), np.uint8)
        if mask.shape != left.shape[:2]:
            sizes = ["x".join(map(str, one.shape[1::-1])) for one in (mask, left)]
            image = context.request.dark
            raise ToktError(f"the mask {file} is {sizes[0]}, its image {image} is {sizes[1]}")
        return mask, truth_by_mask(mask), f"the mask {file.name}"
    truth = None if number is None else context.labelled.get(number)
    if truth is None:
        return None, None, "not marked by anybody (give --dark-mask)"
    mask = GRID.paint(truth == 1, *GRID.resized(*left.shape[:2]))
    return mask, truth, "the frame's labels"


class DarkScene:
    """One moment at the tower, rendered in any light with its exact mask, as the thesis's is not.

    The lamp is turned down: what the tower, the water and its snow send back falls by one factor,
    and the sensor's read noise stays. At 1 the picture is as bright as a rendered mission's. Scene,
    snow and noise are the same for every light. The mask is 255 on the tower in the left picture:
    its geometry, however little of it can be seen.
    """

    def __init__(self, width: int) -> None:
        self._scene = MissionScene.draw(SEED, _FRAMES, width)
        self._pose = self._scene.poses[_PLACE]
        cameras = self._pose.cameras(self._scene.rig)
        self._views = [View(camera, self._scene.tower) for camera in cameras]
        depth = self._views[0].image(self._views[0].depth)
        self.mask: U8 = np.isfinite(depth).astype(np.uint8) * 255
        self.nearest_m = float(depth.min())

    def at(self, light: float) -> DarkPicture:
        """The pair by a lamp of `light`, as a share of a rendered mission's."""
        water, rig, straight = _dimmed(self._scene.water, light), self._scene.rig, np.zeros(5)
        shift_mm = 1000.0 * rig.translation_m.reshape(3, 1)
        size = rig.width, rig.height
        return DarkPicture(
            self._picture(water, 0, water.left),
            self._picture(water, 1, water.right),
            self.mask,
            truth_by_mask(self.mask),
            StereoCalibration(
                rig.left, straight, rig.right, straight, rig.rotation, shift_mm, size
            ),
            f"Rendered, without --dark: the tower at {self.nearest_m:.1f} m by a lamp of {light:g} "
            "of a mission's light",
            "the exact rendered mask",
            "the rendered rig's exact calibration",
            rendered=True,
        )

    def _picture(self, water: Water, side: int, response: CameraResponse) -> U8:
        """One camera's picture."""
        moment = np.random.default_rng([SEED, _MOMENT])
        exposure = expose(water, self._scene.rig, self._pose, self._views[side], response, moment)
        return develop(water, exposure, np.random.default_rng([SEED, _SENSOR, side]))


def _dimmed(water: Water, light: float) -> Water:
    lit: dict[str, Any] = {
        name: tuple(value * light for value in getattr(water, name))
        for name in ("lamp", "veil", "veil_floor")
    }
    return replace(water, **lit, snow_brightness=water.snow_brightness * light)


def bad_lighting(context: StudyContext) -> Exhibit:
    """A badly lit picture, a mask of what is in it, every method's predictions (5.6 to 5.8).

    The picture is that of ``--dark`` with the person's mask of ``--dark-mask``; without it a
    rendered one, whose mask is exact.
    """
    dark, sweep = given_picture(context), pd.DataFrame()
    try:
        near = dark.number if dark else None
        texture = train_on_all_labels(context, near)
    except ToktError as error:
        fault = str(error)
        texture = "", lambda frame: fault
    if dark is None:
        # As wide as the mission's frames if that can be rendered.
        width = context.left(context.structure_frame).shape[1]
        scene = DarkScene(int(np.clip(width, *RENDERED_WIDTHS)))
        dark, sweep = scene.at(_LIGHT), _sweep(context, texture, scene)
    said = _predictions(context, texture, dark)
    plots = [
        Plot(
            "predictions",
            f"{dark.words} (5.6); what is there, {dark.truth_words} (5.7); and what each method "
            f"says (5.8). Green outlines are obstacle patches. {DARK_SHOWN}",
            png_of(_figure(dark, said)),
        )
    ]
    caption = (
        f"By patch, against {dark.truth_words}: an obstacle is what covers a tenth of a patch, "
        "less is not scored. Status is by the mean of the mask alone, without a frame rule. "
        f"Counts of patches. Nothing that is trained here learnt from this picture"
        f"{may_have_learnt(said)}"
    )
    tables = [Table("scores", caption, scored_predictions(said, dark.truth))]
    if len(sweep):
        plots.append(_sweep_plot(sweep))
        tables.append(
            Table(
                "by-light",
                "F1 by patch of the same rendered scene as the lamp goes down, and who calls it "
                "clear. Empty where a method cannot judge the picture.",
                sweep,
            )
        )
    return Exhibit(
        _words(dark, said),
        _claims(said, dark),
        tuple(tables),
        tuple(plots),
        _numbers(said, dark, sweep),
    )


def _predictions(
    context: StudyContext, texture: Texture, dark: DarkPicture, slow: bool = True
) -> list[MethodPrediction]:
    """What every method says of a picture; without `slow` the superpixels are left out."""
    frame, (words, judge) = dark.left, texture
    return [
        *by_thesis(context, frame),
        *(by_superpixels(context, dark.number or 0, frame) if slow else []),
        said_by_patches(TOKT_TEXTURE, "tokt texture", OURS, words, judge(frame), frame),
        *by_bundle(context, frame, "the model as given"),
        by_stereo(dark.calibration, frame, dark.right, dark.calibration_words),
    ]


def _words(dark: DarkPicture, said: Said) -> tuple[str, ...]:
    return (
        f"{dark.words}; {dark.truth_words}. A method that cuts a picture otherwise is scored by "
        "the patches with a tenth or more white. What could not judge the picture is not scored "
        "as clear.",
        (
            "For models of a real mission a rendered picture is another world: it shows the order "
            "of things, not figures for the sea. Methods that need the frames before have nothing "
            "to judge here."
            if dark.rendered
            else "Methods that need a pair or the frames before have nothing to judge here."
        ),
        *learnt_words((one.title, one.words) for one in said),
    )


def _f1(one: MethodPrediction, dark: DarkPicture) -> float | None:
    score = one.score(dark.truth)
    return score.f1 if score else None


def _claims(said: Said, dark: DarkPicture) -> tuple[Claim, ...]:
    if dark.truth is None:
        return (_claim("which method finds most in bad light", "no mask to score by", dark),)
    f1 = {one.title: _f1(one, dark) or 0.0 for one in said if one.patches is not None}
    ranked = sorted(f1, key=lambda title: -f1[title])
    listed = ", ".join(f"{title} {f1[title]:.2f}" for title in ranked)
    claims = [
        _claim(
            "which method comes nearest to a person in bad light", f"F1 by patch: {listed}", dark
        )
    ]
    if (dark.truth == 1).any():
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
    return Claim(what, NOT_KNOWN, found, why)


def _figure(dark: DarkPicture, said: Said) -> Figure:
    n_rows = -(-(3 + len(said)) // 3)
    figure = Figure(figsize=(11.5, 3.05 * n_rows + 0.4), layout="constrained")
    panels = list(figure.subplots(n_rows, 3, squeeze=False).ravel())
    height, width = GRID.resized(*dark.left.shape[:2])
    small = cv2.resize(dark.left, (width, height), interpolation=cv2.INTER_AREA)
    panels[0].imshow(small[..., ::-1] if small.ndim == 3 else small, cmap="gray", vmin=0, vmax=255)
    show_dark(panels[1], dark.left)
    if dark.mask is not None:
        show_mask(panels[2], dark.mask)
    titles = ["as the camera gives it", "amplified", dark.truth_words]
    for axes, title in zip(panels, titles, strict=False):
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=9, loc="left")
    for axes, one in zip(panels[3:], said, strict=False):
        _panel(axes, dark, one)
    for axes in panels[3 + len(said) :]:
        axes.set_axis_off()
    explain_dots(panels[3 * (n_rows - 1)], dark.truth is not None)
    return figure


def _panel(axes: Any, dark: DarkPicture, one: MethodPrediction) -> None:
    size = show_dark(axes, dark.left)
    if dark.truth is not None:
        draw_truth(axes, dark.truth, *size)
    if one.patches is not None:
        draw_dots(axes, one.patches, *size)
        f1 = _f1(one, dark)
        title = one.title if f1 is None else f"{one.title}: F1 {f1:.2f}"
    else:
        title = f"{one.title}: not judged"
        axes.text(
            0.5, 0.5, one.fault, transform=axes.transAxes, color="white", fontsize=9, wrap=True,
            ha="center", va="center", bbox={"facecolor": "black", "alpha": 0.7},
        )  # fmt: skip
    axes.set_title(title, fontsize=9, loc="left")


def _sweep(context: StudyContext, texture: Texture, scene: DarkScene) -> pd.DataFrame:
    """A row a light, a column a method: F1, or nothing where it was not judged."""
    rows = []
    for light in _LIGHTS:
        dark = scene.at(light)
        said = _predictions(context, texture, dark, slow=False)
        rows.append(
            {"light": light, "mean grey level": float(np.mean(dark.left))}
            | {one.title: _f1(one, dark) for one in said}
            | {_SAYS_CLEAR: ", ".join(_say_clear(said))}
        )
    return pd.DataFrame(rows)


def _say_clear(said: Said) -> list[str]:
    return [one.title for one in said if one.status == STATUS_WORDS[CLEAR]]


def _methods(sweep: pd.DataFrame) -> list[str]:
    """Titles of the methods in a sweep, which may be empty."""
    known = {"light", "mean grey level", _SAYS_CLEAR}
    return [str(name) for name in sweep.columns if name not in known]


def _sweep_plot(sweep: pd.DataFrame) -> Plot:
    figure, axes = new_figure(8.0, 3.6)
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


def _numbers(said: Said, dark: DarkPicture, sweep: pd.DataFrame) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "rendered": dark.rendered,
        "mean_grey": float(np.mean(dark.left)),
        "methods": len(said),
        "not_judged": sum(one.patches is None for one in said),
    }
    if dark.truth is not None:
        numbers["obstacle_patches"] = int((dark.truth == 1).sum())
        if (dark.truth == 1).any():
            numbers["wrong_clear"] = ", ".join(_say_clear(said))
    for one in said:
        if score := one.score(dark.truth):
            numbers |= {f"{one.name}_{figure}": value for figure, value in score.figures().items()}
    for name in _methods(sweep):
        enough = sweep.loc[sweep[name].astype(float) > 0.5, "light"]
        numbers[f"least_light_{name}"] = float(enough.min()) if len(enough) else None
    return numbers
