"""Tables 5.1 to 5.4: the run time of each method, stage by stage, in turns on one thread.

What is counted is the thread's own processor time: on an idle machine the time that passes, and on
a busy one not what others take.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tokt.features.common.arrays import F64, U8
from tokt.features.common.errors import FrameError
from tokt.features.common.machine import machine
from tokt.features.extractors.extractor import Extractor
from tokt.features.frames.image_file import decode_image
from tokt.features.frames.mission import LEFT, RIGHT
from tokt.inference.config import DEFAULT_SCALE
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Policy, SinglePolicy
from tokt.inference.sight import SightMeter
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.pushbroom import PushbroomDetector
from tokt.inference.verdict import Verdict, verdict_from_mask
from tokt.models.linear import LinearModel
from tokt_studies.baselines import thesis_stereo
from tokt_studies.baselines.mean_disparity import Thirds
from tokt_studies.baselines.slic import SlicTexture, resized_bgr, superpixels
from tokt_studies.baselines.thesis_models import ThesisModel
from tokt_studies.baselines.thesis_texture import GRID, resized_gray
from tokt_studies.speed.paired_timing import in_turns, single_thread
from tokt_studies.thesis.methods.curves import COMPARED, OURS, THESIS

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import new_figure, png_of
from .training_image_figures import EXTRACTORS

STAGES = (
    "decode",
    "resize",
    "superpixels",
    "features",
    "predict",
    "undistort",
    "match",
    "contours",
)
"""In the order of a table. The last one is all that is left: masks, outlines, the verdict, and in
tokt's methods its checks of the frame."""
REST = STAGES[-1]

T = TypeVar("T")


class Laps:
    """Seconds of the stages of one run."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self._last = time.thread_time()

    def lap(self, stage: str) -> None:
        """Count the time since the last lap, but for what was counted inside it, for a stage."""
        now = time.thread_time()
        self.seconds[stage] += now - self._last
        self._last = now

    def inside(self, stage: str, call: Callable[[], T]) -> T:
        """Do something in the middle of another stage, and count it for this one."""
        began = time.thread_time()
        done = call()
        took = time.thread_time() - began
        self.seconds[stage] += took
        self._last += took
        return done

    def split_off(self, stage: str, call: Callable[[], T], less_s: float = 0.0) -> T:
        """Do again what was a part of `REST`, and count the time it takes for this stage.

        For a part of a call that cannot be looked into: the total stays that of the one call. Of
        the part `less_s` seconds were split off already.
        """
        began = time.thread_time()
        done = call()
        took = max(0.0, time.thread_time() - began - less_s)
        took = min(took, self.seconds[REST])
        self.seconds[stage] += took
        self.seconds[REST] -= took
        self._last = time.thread_time()
        return done


class EncodedPair(NamedTuple):
    """A frame, or a pair, as it lies on the disk."""

    number: int
    left: bytes
    right: bytes | None = None


@dataclass(frozen=True)
class TimedMethod:
    """One method, of a kind as in `curves`, that judges a pair and tells `Laps` about it."""

    key: str
    title: str
    kind: str
    run: Callable[[EncodedPair, Laps], Verdict]


@dataclass(frozen=True)
class StageTimes:
    """Seconds (n_frames, n_stages) of one method, in the order of the frames."""

    method: TimedMethod
    seconds: F64

    @property
    def total_ms(self) -> F64:
        """(n_runs,)"""
        return np.asarray(self.seconds.sum(axis=1) * 1e3)

    @property
    def stage_ms(self) -> pd.Series:
        """Medians, by stage."""
        return pd.Series(np.median(self.seconds, axis=0) * 1e3, list(STAGES))


def time_stages(methods: Sequence[TimedMethod], frames: Sequence[EncodedPair]) -> list[StageTimes]:
    """Time each method on each frame once, the methods in turns (`in_turns`)."""
    seconds: dict[str, dict[int, list[float]]] = {method.key: {} for method in methods}

    def judge(method: TimedMethod, item: EncodedPair) -> None:
        laps = Laps()
        method.run(item, laps)
        seconds[method.key][item.number] = list(laps.seconds.values())

    in_turns({method.key: partial(judge, method) for method in methods}, frames, 1)
    return [
        StageTimes(method, np.array([seconds[method.key][frame.number] for frame in frames]))
        for method in methods
    ]


def _decoded(data: bytes, laps: Laps) -> U8:
    image = decode_image(data, "a frame")
    laps.lap("decode")
    return image


def thesis_texture(model: ThesisModel) -> TimedMethod:
    """The thesis's way on the grid: a library call and a predict call a patch."""

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        frame = _decoded(item.left, laps)
        gray = resized_gray(frame)
        laps.lap("resize")
        rows = [model.describe(patch) for patch in GRID.cells(gray)]
        laps.lap("features")
        white = [model.classifier.predict(row.reshape(1, -1))[0] == 1 for row in rows]
        laps.lap("predict")
        verdict = verdict_from_mask(GRID.paint(np.array(white), *gray.shape), "thesis")
        laps.lap(REST)
        return verdict

    return TimedMethod(model.name, f"{model.title}, 10x10 patches", THESIS, run)


class _Timed:
    """A method's describe function and classifier, their time counted for the run that is on."""

    def __init__(self, method: SlicTexture) -> None:
        self.laps, self._method = Laps(), method

    def describe(self, patch: U8) -> F64:
        return self.laps.inside("features", lambda: self._method.describe(patch))

    def predict(self, rows: F64) -> Any:
        return self.laps.inside("predict", lambda: self._method.classifier.predict(rows))


def slic_texture(method: SlicTexture) -> TimedMethod:
    """The thesis's way on superpixels. Resize and superpixels are split off by doing them again."""
    timed = _Timed(method)
    watched = SlicTexture(timed.describe, timed, method.name)

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        timed.laps = laps
        frame = _decoded(item.left, laps)
        verdict = verdict_from_mask(watched.mask(frame), watched.name)
        laps.lap(REST)
        picture = laps.split_off("resize", lambda: resized_bgr(frame))
        laps.split_off("superpixels", lambda: superpixels(picture))
        return verdict

    return TimedMethod(method.name, method.title, THESIS, run)


def _of_pairs(
    names: tuple[str, str, str],
    judge: Callable[[int, U8, U8], Verdict],
    parts: tuple[Callable[[U8, U8], object], Callable[[U8, U8], object]] | None = None,
) -> TimedMethod:
    """A method of pairs by its key, title and kind.

    `parts` are its undistortion, and the same with the matching: split off by doing them again.
    """

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        pair = _decoded(item.left, laps), _decoded(item.right or b"", laps)
        verdict = judge(item.number, *pair)
        laps.lap(REST)
        if parts is not None:
            undistort, match = parts
            laps.split_off("undistort", lambda: undistort(*pair))
            laps.split_off("match", lambda: match(*pair), less_s=laps.seconds["undistort"])
        return verdict

    return TimedMethod(*names, run)


def thesis_disparity() -> TimedMethod:
    """The thesis's disparity of a pair of 1360x1024."""
    return _of_pairs(
        ("disparity", "disparity, a pair", THESIS),
        lambda _, left, right: thesis_stereo.judge_pair(left, right).verdict,
        (thesis_stereo.undistorted_pair, thesis_stereo.disparity_map),
    )


def tokt_texture(
    extractor: Extractor, model: LinearModel, key: str = "tokt_texture", title: str = "tokt texture"
) -> TimedMethod:
    """A texture model as tokt deploys it: its kernels, and one matrix product for all patches."""

    def run(item: EncodedPair, laps: Laps) -> Verdict:
        frame = _decoded(item.left, laps)
        shown = Frame(0, 0.0, frame, None)
        pictures = shown.pictures("left", GRID)
        pictures.prepare(extractor.images)
        laps.lap("resize")
        SightMeter().of(shown)
        laps.lap(REST)
        features = extractor.describe_pictures(pictures)
        laps.lap("features")
        white = model.obstacle_patches(model.decision_values(features))
        laps.lap("predict")
        verdict = verdict_from_mask(GRID.paint(white, *pictures.size), "texture")
        laps.lap(REST)
        return verdict

    return TimedMethod(key, title, OURS, run)


def thesis_model_with_kernels(model: ThesisModel) -> TimedMethod:
    """One of the thesis's models with tokt's kernels: the same weights, the same verdicts."""
    weights = np.asarray(model.classifier.coef_, np.float64)
    bias = np.asarray(model.classifier.intercept_, np.float64)
    linear = LinearModel(weights, bias, np.zeros(1), ("ocean", "other"), (False, True))
    title = f"{model.title}, tokt's kernels"
    return tokt_texture(EXTRACTORS[model.name], linear, f"tokt_{model.name}", title)


def cited_methods(calibration: StereoCalibration) -> list[TimedMethod]:
    """Pushbroom stereo as tokt has it, and thirds of the disparity map, a pair each."""
    pushbroom = SinglePolicy(PushbroomDetector(calibration, GRID))
    return [
        _of_pairs((key, f"{CITED_S[key][0]}, a pair", COMPARED), partial(_verdict, method))
        for key, method in (("pushbroom", pushbroom), ("thirds", Thirds(calibration)))
    ]


def _verdict(method: Policy, number: int, left: U8, right: U8) -> Verdict:
    return method.judge(Frame(number, float(number), left, right)).verdict


def tokt_stereo(
    calibration: StereoCalibration, scale: float = DEFAULT_SCALE, key: str = "tokt_stereo"
) -> TimedMethod:
    """The disparity that tokt would run, of a pair; undistortion is rectification here."""
    detector = DisparityDetector(calibration, GRID, scale=scale)
    rectifier = detector.rectifier

    def rectify(left: U8, right: U8) -> object:
        return rectifier.left(left), rectifier.right(right, detector.row_shift_px)

    return _of_pairs(
        (key, "tokt stereo, a pair" + " at full size" * (scale != DEFAULT_SCALE), OURS),
        partial(_verdict, SinglePolicy(detector)),
        (rectify, lambda left, right: detector.match(left, right, detector.row_shift_px)),
    )


SPREAD = (10, 90)
REFERENCE = "lbp_10_5"
SEQUENCE = 245
"""Images of the thesis's sequence; it does not say how many of them its run times are of."""
NEAR, TWICE = 1.25, 2.0
"""A ratio within a quarter of the printed one agrees; within twice it agrees in part."""
HALF_SIZE = "tokt_stereo_full_size"


class PrintedRow(NamedTuple):
    """A row of the thesis's tables 5.1 to 5.4, and what it is here."""

    table: str
    row: str
    seconds: float
    key: str  # of the method
    stages: tuple[str, ...] = ()  # that are the same; none is nothing to compare with
    copied: bool = False  # from another table, by mistake: it is longer than what it is a part of


PRINTED = (
    PrintedRow("5.1 SLIC + LBP", "module", 1153, "slic_lbp_10_5", STAGES),
    PrintedRow("5.1 SLIC + LBP", "main", 1150, "slic_lbp_10_5"),
    PrintedRow("5.1 SLIC + LBP", "init", 1090, "slic_lbp_10_5"),
    PrintedRow("5.1 SLIC + LBP", "slic", 957, "slic_lbp_10_5", ("superpixels",)),
    PrintedRow("5.1 SLIC + LBP", "slic_cython", 932, "slic_lbp_10_5"),
    PrintedRow("5.2 LBP", "module", 58.5, "lbp_10_5", STAGES),
    PrintedRow("5.2 LBP", "main", 57.9, "lbp_10_5"),
    PrintedRow("5.2 LBP", "init", 37.4, "lbp_10_5"),
    PrintedRow("5.2 LBP", "predictMaskedImage", 35.4, "lbp_10_5", ("features", "predict")),
    PrintedRow("5.2 LBP", "describe", 17.6, "lbp_10_5", ("features",)),
    PrintedRow("5.2 LBP", "imread", 9.20, "lbp_10_5", ("decode",)),
    PrintedRow("5.3 disparity", "module", 69.5, "disparity", STAGES),
    PrintedRow("5.3 disparity", "main (labelled haralick)", 69.2, "disparity"),
    PrintedRow("5.3 disparity", "process", 48.5, "disparity", ("undistort", "match")),
    PrintedRow("5.3 disparity", "disparityCalc", 74, "disparity", copied=True),
    PrintedRow("5.3 disparity", "getDisparity", 54.1, "disparity", copied=True),
    PrintedRow("5.3 disparity", "undistort", 16.9, "disparity", ("undistort",)),
    PrintedRow("5.3 disparity", "imread", 9.18, "disparity", ("decode",)),
    PrintedRow("5.4 Haralick", "module", 101, "haralick", STAGES),
    PrintedRow("5.4 Haralick", "main", 100, "haralick"),
    PrintedRow("5.4 Haralick", "init", 75.9, "haralick"),
    PrintedRow("5.4 Haralick", "predictMaskedImage", 74, "haralick", ("features", "predict")),
    PrintedRow("5.4 Haralick", "describe", 54.1, "haralick", ("features",)),
    PrintedRow("5.4 Haralick", "imread", 9.25, "haralick", ("decode",)),
)
WHOLE_S = {one.key: one.seconds for one in PRINTED if one.stages == STAGES}
"""Of each method, for the whole sequence."""
CITED_S = {"pushbroom": ("pushbroom stereo", 0.02), "thirds": ("thirds of disparity", 2.317)}
"""Of others' methods, for a pair, as the thesis tells it (section 2.11)."""
THEIR_MACHINE = (
    "The thesis's: Acer Aspire VN7-792G, Core i7-6700HQ at 2.6 GHz, 8 GiB. Windows 10, Python "
    "2.7.11, numpy 1.10.4, scipy 0.17.0, scikit-learn 0.17 (tables 2.1 and 2.2). It prints no "
    "version of OpenCV, scikit-image or mahotas."
)
_NO_PAIRS = "not measured", "it needs pairs with a calibration"
_VERSIONS = ("numpy", "opencv-python-headless", "scikit-image", "scikit-learn", "mahotas")

Found = dict[str, StageTimes]
"""By key of the method."""


def runtime_tables(context: StudyContext) -> Exhibit:
    """Time the thesis's methods and ours on the same frames, in turns, in this one run."""
    with single_thread():
        methods = methods_of(context)
        frames = _frames(context)
        measured = time_stages(methods, frames)
    found = {one.method.key: one for one in measured}
    caption = (
        "Median time of each stage, in ms, on one thread. Undistort is rectification in tokt's "
        "stereo. Contours is all that is left: masks, outlines, the verdict, and in tokt's rows "
        "its checks of the frame. For SLIC, the thesis's disparity and tokt's stereo the parts of "
        "a call are split by doing them once more, outside the total."
    )
    return Exhibit(
        _words(context, frames),
        _claims(found),
        _tables(found, len(frames)),
        (Plot("run_times", caption, png_of(_chart(found))),),
    )


def methods_of(context: StudyContext) -> list[TimedMethod]:
    """All methods that can judge this mission's frames."""
    methods = [slic_texture(one) for one in context.superpixel_methods.textures]
    methods += [thesis_texture(model) for model in context.thesis.values()]
    size = context.any_picture().shape[1::-1]
    if context.pairs and size == thesis_stereo.THESIS_FRAME_SIZE:
        methods.append(thesis_disparity())
    methods += [thesis_model_with_kernels(model) for model in context.thesis.values()]
    own, _ = context.tokt_model
    if own.grid == GRID:
        methods.append(tokt_texture(own.extractor, own.model))
    if context.calibration is not None:
        methods.append(tokt_stereo(context.calibration))
        methods.append(tokt_stereo(context.calibration, 1.0, HALF_SIZE))
        methods += cited_methods(context.calibration)
    return methods


def _frames(context: StudyContext) -> list[EncodedPair]:
    """Encoded frames spread over the mission; pairs where it has pairs."""
    mission, numbers, cameras = context.mission, context.spread(), [LEFT]
    if context.pairs:
        cameras, both = [LEFT, RIGHT], set(context.pairs)
        numbers = [number for number in numbers if number in both] or context.pairs[:1]
    found = []
    for number in numbers:
        try:
            for camera in cameras:
                mission.read(number, camera)
        except FrameError:
            continue
        found.append(EncodedPair(number, *(mission.encoded(number, one)[0] for one in cameras)))
    if not found:
        raise FrameError("none of the frames chosen for the run times can be read")
    return found


def _words(context: StudyContext, frames: Sequence[EncodedPair]) -> tuple[str, ...]:
    _, own = context.tokt_model
    seen = ", ".join(str(frame.number) for frame in frames)
    about = machine()
    return (
        f"Every method judges the same {len(frames)} frames ({seen}), in turns, on one thread. A "
        "time goes from the bytes of the image file to the verdict. It is processor time: on an "
        "idle machine the time that passes. Medians, with the 10th and 90th percentile of the "
        "single runs.",
        "The thesis's methods are its settings with today's libraries. The rows of tokt's kernels "
        f"judge with the very weights of the thesis's models. tokt texture is {own}. Times do not "
        "depend on what a model learnt.",
        THEIR_MACHINE,
        f"Here: {about['cpu']}; Python {about['python']}, "
        + ", ".join(f"{name} {version(name)}" for name in _VERSIONS)
        + ".",
    )


def _ratio(found: Found, key: str, to: str = REFERENCE) -> F64:
    """A method's time over another's, run by run: both of the same frame."""
    return found[key].total_ms / found[to].total_ms


def _middle(values: F64) -> tuple[float, float, float]:
    """Median, 10th and 90th percentile."""
    low, high = np.percentile(values, SPREAD)
    return float(np.median(values)), float(low), float(high)


def _tables(found: Found, n_frames: int) -> tuple[Table, Table]:
    caption = (
        "Seconds that the thesis prints for a run, and what that row is here: the median frame's "
        f"stages, times {SEQUENCE}. Parts are of the module, and of the whole frame. Rows copied "
        "by mistake are not compared."
    )
    compared = pd.DataFrame(
        {
            "method": one.method.title,
            "whose": one.method.kind,
            "median ms": np.median(one.total_ms),
            "times LBP": np.median(_ratio(found, key)),
            "printed": WHOLE_S.get(key, np.nan) / WHOLE_S[REFERENCE],
        }
        for key, one in found.items()
    )
    words = (
        f"{n_frames} frames, once each: median ms a frame (a pair for the disparities), and times "
        "the thesis's LBP on the same frame."
    )
    return (
        Table("printed_rows", caption, _printed_rows(found)),
        Table("run_times", words, compared),
    )


def _printed_rows(found: Found) -> pd.DataFrame:
    """The thesis's rows, with ours beside them."""
    rows = []
    for one in PRINTED:
        there = [one.table, one.row, one.seconds, one.seconds / WHOLE_S[one.key]]
        if one.copied:
            rows.append([*there[:3], None, "copied by mistake", None, None])
            continue
        here = found.get(one.key)
        if here is None or not one.stages:
            rows.append([*there, "none", None, None])
            continue
        whole = float(np.median(here.total_ms))
        words, ms = "whole frame", whole
        if one.stages != STAGES:
            words, ms = " and ".join(one.stages), float(here.stage_ms[list(one.stages)].sum())
        rows.append([*there, words, ms * SEQUENCE / 1e3, ms / whole])
    columns = ["table", "row", "thesis s", "part of it", "here", "s", "part"]
    return pd.DataFrame(rows, columns=columns)


def _claims(found: Found) -> tuple[Claim, ...]:
    return (
        _claim(found, "slic_lbp_10_5", "SLIC + LBP takes so many times as long as LBP on patches"),
        _claim(found, "disparity", "disparity takes so many times as long as LBP"),
        _claim(found, "haralick", "Haralick takes so many times as long as LBP"),
        *(_cited_claim(found, key) for key in CITED_S),
        _smaller_claim(found),
    )


def _cited_claim(found: Found, key: str) -> Claim:
    title, seconds = CITED_S[key]
    claim = Claim.about(
        f"{title} takes so long a pair", f"{seconds:g} s, another machine (section 2.11)"
    )
    if key not in found:
        return claim(*_NO_PAIRS)
    taken_s = float(np.median(found[key].total_ms)) / 1e3
    times, way = max((taken_s / seconds, "long"), (seconds / taken_s, "fast"))
    return claim(
        f"{taken_s:.3g} s, from the images' bytes: {times:.3g} times as {way}",
        "to agree: within a quarter, longer or shorter; in part: within twice",
        agreement=agreement_of(taken_s, seconds),
    )


def _smaller_claim(found: Found) -> Claim:
    claim = Claim.about("a smaller pair speeds up matching", "proposed, not measured (section 5.2)")
    if HALF_SIZE not in found:
        return claim(*_NO_PAIRS)
    ratio, low, high = _middle(_ratio(found, HALF_SIZE, "tokt_stereo"))
    return claim(
        f"tokt's stereo at full size: {ratio:.2g} times as long ({low:.2g} to {high:.2g})",
        "to agree: the 10th percentile of single runs is above 1",
        agreement=ClaimAgreement.YES if low > 1 else ClaimAgreement.NO,
    )


def agreement_of(ratio: float, printed: float) -> ClaimAgreement:
    """Agreement of a ratio with a printed one: see `NEAR` and `TWICE`."""
    off = max(ratio / printed, printed / ratio)
    return ClaimAgreement.of(off <= NEAR, off <= TWICE)


def _claim(found: Found, key: str, what: str) -> Claim:
    theirs, reference = WHOLE_S[key], WHOLE_S[REFERENCE]
    ratio_there = theirs / reference
    seconds = f"{theirs:g} s to {reference:g} s"
    claim = Claim.about(what, f"{ratio_there:.3g} ({seconds}; tables 5.1 to 5.4)")
    if key not in found:
        why = f"this mission has no pairs of {thesis_stereo.THESIS_SIZE_WORDS}, the thesis's size"
        return claim("not measured", why)
    ratio, low, high = _middle(_ratio(found, key))
    own = found[key].stage_ms
    return claim(
        f"{ratio:.3g} ({low:.3g} to {high:.3g})",
        f"to agree: within a quarter; in part: within twice. {own.idxmax()} takes {own.max():.1f} "
        f"of {np.median(found[key].total_ms):.1f} ms, all of LBP "
        f"{np.median(found[REFERENCE].total_ms):.1f}",
        agreement=agreement_of(ratio, ratio_there),
    )


def _chart(found: Found) -> Figure:
    """Stacked bars of the stages' medians."""
    figure, axes = new_figure(10, 0.5 + 0.42 * len(found))
    stages = pd.DataFrame({one.method.title: one.stage_ms for one in found.values()})
    left = np.zeros(len(found))
    for place, (stage, width) in enumerate(stages.iterrows()):
        axes.barh(stages.columns, width, left=left, label=stage, color=f"C{place}")
        left += width.to_numpy()
    for at, (total, one) in enumerate(zip(left, found.values(), strict=True)):
        axes.text(total, at, f" {np.median(one.total_ms):.1f}", va="center", fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("ms a frame, median")
    axes.margins(x=0.08)
    axes.legend(fontsize=8, ncols=4, loc="lower right")
    return figure
