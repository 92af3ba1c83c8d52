"""Figures 5.6 to 5.8: bad light, what a person marks in it, and what every method says."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tokt.features.common.arrays import U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import read_image
from tokt.features.frames.mission import LEFT
from tokt.inference.sight import SightMeter
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD
from tokt.models.bundle.bundle import Bundle
from tokt_studies.baselines.thesis_models import TITLES, thesis_classifier
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.simulation.scene.rig import FULL_WIDTH
from tokt_studies.thesis.light_scene import BRIGHT, BadPicture, LitScene, by_lamp
from tokt_studies.thesis.methods.curves import OURS, learnt_words
from tokt_studies.thesis.methods.mission_models import TOKT_TEXTURE, learnt_from_labels
from tokt_studies.thesis.patch_scores import Truth, truth_by_mask

from . import frame_drawing as drawing
from .dot_figures import MethodPrediction, by_disparity, by_stereo, by_thesis, said_by_patches
from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .training_image_figures import described

SEED, TRAINING_SEED = 8, 9
"""Of the rendered scene, and of the bright water that is learnt from."""
RENDERED_WIDTHS = (360, FULL_WIDTH)
"""Least and largest width in pixels of a picture; the methods look at 360."""
LIGHTS = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Of the sea trial's lamp; each half of the one before, so one stop. All but the first are low."""
LBP, HARALICK, DISPARITY = TITLES["lbp_10_5"], TITLES["haralick"], "disparity"
_NEARLY_ALL = 0.8
_AROUND = 2.0
"""A status hangs on its threshold where this many times more or less of it changes the status."""

Said = Sequence[MethodPrediction]
Texture = tuple[Bundle | None, str]
"""Our model and what it learnt from, or why there is none."""


def given_picture(context: StudyContext) -> BadPicture | None:
    """The image of ``--picture``, the mask of ``--picture-mask``; None where no image was given.

    An image that is a frame of the mission has a right picture, and labels that stand in for a
    mask. Raises ToktError if a file cannot be read, or the mask is of another size than the image.
    """
    file = context.request.picture
    if file is None:
        return None
    left, number = read_image(file), context.frame_with(file)
    words, right = f"The image {file.name}", None
    if number is not None:
        words += f", which is the mission's frame {number}"
        # One of the right camera's has no pair to it on its right.
        right = context.right(number) if context.request.camera == LEFT else None
    calibration, calibration_words = None, ""
    if right is not None:
        calibration, calibration_words = context.calibration, context.calibration_words
    mask, truth, truth_words = _truth(context, left, number)
    return BadPicture(
        left, right, mask, truth, calibration, words, truth_words, calibration_words, number=number
    )


def _truth(
    context: StudyContext, left: U8, number: int | None
) -> tuple[U8 | None, Truth | None, str]:
    """A mask to show, the truth by patch, and whose it is."""
    file = context.request.picture_mask
    if file is not None:
        mask = read_image(file)
        if mask.ndim == 3:
            mask = np.asarray(cv2.cvtColor(mask, cv2.COLOR_BGR2GRAY), np.uint8)
        if mask.shape != left.shape[:2]:
            sizes = ["x".join(map(str, one.shape[1::-1])) for one in (mask, left)]
            image = context.request.picture
            raise ToktError(f"the mask {file} is {sizes[0]}, its image {image} is {sizes[1]}")
        return mask, truth_by_mask(mask), f"the mask {file.name}"
    truth = None if number is None else context.labelled.get(number)
    if truth is None:
        return None, None, "not marked by anybody (give --picture-mask)"
    mask = GRID.paint(truth == 1, *GRID.resized(*left.shape[:2]))
    return mask, truth, "the frame's labels"


def bad_lighting(context: StudyContext) -> Exhibit:
    """A picture in bad light, a mask of what is in it, every method's predictions (5.6 to 5.8).

    The picture is that of ``--picture`` with the person's mask of ``--picture-mask``; without it a
    rendered river by day, whose mask is exact. Low light is rendered either way.
    """
    # As wide as the mission's frames if that can be rendered.
    width = int(np.clip(context.any_picture().shape[1], *RENDERED_WIDTHS))
    bad = given_picture(context) or LitScene(width, SEED, fish=True).at(
        BRIGHT,
        "bright green water by day, a tower and fish. Both are to be found, as nobody would call "
        "them water",
    )
    try:
        texture: Texture = learnt_from_labels(context, bad.number)
    except ToktError as error:
        texture = None, str(error)
    said = _predictions(context, texture, bad)
    low = low_light(context, texture, LitScene(width, SEED))
    by_light = (
        "F1 by patch of a rendered tower in the sea trial's water as the lamp goes down, and the "
        "mean values of the thesis's masks. Empty where a method cannot judge."
    )
    caption = (
        f"{bad.words} (5.6); what is there, {bad.truth_words} (5.7); and what each method says "
        f"(5.8). Green outlines are obstacle patches. {drawing.SHOWN}"
    )
    return Exhibit(
        _words(bad, said),
        (
            river_claim(said, bad),
            training_claim(said, bad, _trained_on_bright_water(context, bad, width)),
            low_light_claim(low),
        ),
        (_scores(said, bad), Table("by-light", by_light, low)),
        (Plot("predictions", caption, drawing.png_of(_figure(bad, said))),),
    )


def _predictions(
    context: StudyContext, texture: Texture, bad: BadPicture
) -> list[MethodPrediction]:
    """What every method says of a picture."""
    frame, (bundle, words) = bad.left, texture
    patches: Bools | str = words
    if bundle is not None:
        sight = SightMeter(bundle.sight).measure(frame)
        patches = str(sight.fault) if sight.is_blind else ""
    if bundle is not None and not patches:
        values = bundle.model.decision_values(bundle.extractor.describe(frame, GRID))
        patches = bundle.model.obstacle_patches(values)
    return [
        *by_thesis(context, frame),
        by_disparity(frame, bad.right),
        said_by_patches(TOKT_TEXTURE, "tokt texture", OURS, words, patches, frame),
        by_stereo(bad.calibration, frame, bad.right, bad.calibration_words),
    ]


def _words(bad: BadPicture, said: Said) -> tuple[str, ...]:
    return (
        f"{bad.words}; {bad.truth_words}. A method that cuts a picture otherwise is scored by "
        "the patches with a tenth or more white. What could not judge the picture is not scored "
        "as clear.",
        (
            "The thesis's picture is not at hand. To models of a real mission a rendered one is "
            "another world: it shows the order of things, not figures for the sea."
            if bad.rendered
            else "Methods that need a pair or the frames before have nothing to judge here."
        ),
        *learnt_words((one.title, one.words) for one in said),
    )


def _scores(said: Said, bad: BadPicture) -> Table:
    caption = (
        f"By patch, against {bad.truth_words}: an obstacle is what covers a tenth of a patch, "
        "less is not scored. Status is by the mean of the mask alone, without a frame rule. "
        "Nothing here learnt from this picture."
    )
    rows = []
    for one in said:
        score = one.score(bad.truth)
        figures = {"precision": score.precision, "recall": score.recall, "f1": score.f1}
        who = {"method": one.title, "whose": one.kind, "status": one.status}
        rows.append(who | figures | {"not judged": one.fault})
    return Table("scores", caption, pd.DataFrame(rows))


def river_claim(said: Said, bad: BadPicture) -> Claim:
    """Whether LBP finds nearly everything in the picture, and Haralick does worse."""
    claim = Claim.about(
        "in a bright river LBP finds nearly everything, and Haralick does badly",
        "figures 5.6 to 5.8, by models trained on blue water",
    )
    if bad.truth is None or not (bad.truth == 1).any():
        return claim("not scored", "the picture has no mask of anything in it")
    scores = {one.title: one.score(bad.truth) for one in said}
    (recall, f1), (less, other) = (
        (scores[title].recall or 0.0, scores[title].f1 or 0.0) for title in (LBP, HARALICK)
    )
    finds, leads = recall >= _NEARLY_ALL, f1 > other
    return claim(
        f"{LBP}: recall {recall:.2f}, F1 {f1:.2f}; {HARALICK}: recall {less:.2f}, F1 {other:.2f}",
        f"to agree: LBP's recall {_NEARLY_ALL} or more, its F1 the higher; in part: one of both",
        agreement=ClaimAgreement.of(finds and leads, finds or leads),
    )


def _trained_on_bright_water(
    context: StudyContext, bad: BadPicture, width: int
) -> dict[str, float] | None:
    """F1 of LBP and Haralick that learnt from other bright water; None where none is at hand."""
    if not bad.rendered:
        return None
    water = LitScene(width, TRAINING_SEED, tower=False).at(BRIGHT).left
    ocean, other, picture = (described(one) for one in (water, context.other.image, bad.left))
    found = {}
    for name in ("lbp_10_5", "haralick"):
        patches = thesis_classifier(ocean[name], other[name]).predict(picture[name]) == 1
        said = said_by_patches(name, TITLES[name], "", "", patches, bad.left)
        found[said.title] = said.score(bad.truth).f1 or 0.0
    return found


def training_claim(said: Said, bad: BadPicture, after: dict[str, float] | None) -> Claim:
    """Whether models that learnt from bright water are better in it."""
    claim = Claim.about("training on bright water would help", "section 5.3")
    if after is None:
        why = "no other open water of the given picture's kind is at hand to learn from"
        return claim("not trained", why)
    before = {one.title: one.score(bad.truth).f1 or 0.0 for one in said if one.title in after}
    helped = [after[title] > before[title] for title in after]
    return claim(
        "; ".join(f"{title}: F1 {before[title]:.2f}, then {after[title]:.2f}" for title in after),
        "learnt from other rendered water; to agree: both better; in part: one",
        agreement=ClaimAgreement.of(all(helped), any(helped)),
    )


def low_light(context: StudyContext, texture: Texture, scene: LitScene) -> pd.DataFrame:
    """A row a light, a column a method: F1, or nothing where it was not judged; and means."""
    rows = []
    for light in LIGHTS:
        picture = scene.at(by_lamp(light))
        said = _predictions(context, texture, picture)
        means: dict[str, float | None] = {
            f"{one.title}, mean": float(one.mask.mean())
            for one in said
            if one.mask is not None and one.title in (LBP, HARALICK, DISPARITY)
        }
        row: dict[str, float | None] = {"light": light, "grey level": float(picture.left.mean())}
        rows.append(row | {one.title: one.score(picture.truth).f1 for one in said} | means)
    return pd.DataFrame(rows)


def low_light_claim(rows: pd.DataFrame) -> Claim:
    """Whether disparity hangs on its threshold in low light, and LBP and Haralick are better."""
    low = rows[rows["light"] < 1]
    f1 = low[[LBP, HARALICK, DISPARITY]].astype(float).fillna(0.0).mean()
    # How many pictures' status another threshold changes.
    least, most = STATUS_MEAN_THRESHOLD / _AROUND, STATUS_MEAN_THRESHOLD * _AROUND
    means = {title: low[f"{title}, mean"] for title in f1.index}
    hang = {title: int(one.between(least, most, "right").sum()) for title, one in means.items()}
    hangs = hang[DISPARITY] > 0 == hang[LBP] == hang[HARALICK]
    better = f1[[LBP, HARALICK]].min() > f1[DISPARITY]
    counted = ", ".join(f"{title} {value:.2f} ({hang[title]})" for title, value in f1.items())
    return Claim(
        "in low light disparity hangs on its size threshold; LBP and Haralick are better",
        "the paper's section II-A",
        f"mean F1 in {len(low)} pairs rendered by half a lamp or less (how many change status with "
        f"half or twice the threshold): {counted}",
        "to agree: both better, and only disparity's status changes; in part: one of both",
        agreement=ClaimAgreement.of(hangs and better, hangs or better),
    )


def _figure(bad: BadPicture, said: Said) -> Figure:
    n_rows = -(-(3 + len(said)) // 3)
    figure, axes = drawing.new_figure(11.5, 3.05 * n_rows + 0.4, n_rows, 3, squeeze=False)
    panels = list(axes.ravel())
    height, width = GRID.resized(*bad.left.shape[:2])
    small = cv2.resize(bad.left, (width, height), interpolation=cv2.INTER_AREA)
    panels[0].imshow(small[..., ::-1] if small.ndim == 3 else small, cmap="gray", vmin=0, vmax=255)
    drawing.show_frame(panels[1], bad.left)
    if bad.mask is not None:
        drawing.show_mask(panels[2], bad.mask)
    titles = ["as the camera gives it", "contrast raised", bad.truth_words]
    for axes, title in zip(panels, titles, strict=False):
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, fontsize=9, loc="left")
    for axes, one in zip(panels[3:], said, strict=False):
        _panel(axes, bad, one)
    for axes in panels[3 + len(said) :]:
        axes.set_axis_off()
    drawing.explain_dots(panels[3 * (n_rows - 1)], bad.truth is not None)
    return figure


def _panel(axes: Any, bad: BadPicture, one: MethodPrediction) -> None:
    size = drawing.show_frame(axes, bad.left)
    if bad.truth is not None:
        drawing.draw_truth(axes, bad.truth, *size)
    if one.patches is not None:
        drawing.draw_dots(axes, one.patches, *size)
        f1 = one.score(bad.truth).f1
        title = one.title if f1 is None else f"{one.title}: F1 {f1:.2f}"
    else:
        title = f"{one.title}: not judged"
        axes.text(
            0.5, 0.5, one.fault, transform=axes.transAxes, color="white", fontsize=9, wrap=True,
            ha="center", va="center", bbox={"facecolor": "black", "alpha": 0.7},
        )  # fmt: skip
    axes.set_title(title, fontsize=9, loc="left")
