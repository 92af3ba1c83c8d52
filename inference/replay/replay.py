"""Judge a run's frames again, from its log and its pictures, and hold the verdicts against it.

A verdict depends on the pictures, on the model, on the frames before, and on a few durations; the
log has the durations and everything else that was not in a picture. So the same model gives the
same verdicts, to the last bit. Where frames before are not known, as in a recording, which holds
clips only, a verdict may come out otherwise without any fault: such frames are judged and
shown, and not counted.

::

    log line ──> Frame as the policy saw it ──> policy ──> late, stale, overload ──> fields
       │            ▲                            ▲                ▲                     │
       │         pictures                  logged seconds    logged age                 ▼
       └──────────────────────────── logged fields ────────────────────────────── compared
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission, open_mission
from tokt.features.frames.view_mask import CameraMasks
from tokt.inference.clock import FixedStopwatch
from tokt.inference.frame import MANY_MISSED, Frame, pixel_mark
from tokt.inference.policy.assembly import Assembly, StereoSetup, assemble
from tokt.inference.policy.moving import REMEMBERED_S
from tokt.inference.policy.object_model import ObjectModel, detail_picture
from tokt.inference.policy.object_naming import named_picture
from tokt.inference.policy.object_tracker import ObjectTracker
from tokt.inference.policy.policy import Judgement
from tokt.inference.policy.temporal_cues import HORIZON_S, Anchor
from tokt.inference.publisher import mark_overloaded, mark_stale
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.recording.run_log import json_values
from tokt.inference.recording.run_start import ModelName, RunStart, used_file
from tokt.inference.report import Report
from tokt.inference.sources.files import read_picture
from tokt.inference.stereo.odometry import Odometry, load_odometry
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import HEALTHY, STATUS_WORDS, TEXTURE, WITHOUT, status_table
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.pretrained.packaged import is_packaged, packaged_bundle
from tokt.models.sight import sight_from_json
from tokt.models.store.store import Store

from .logged_run import ANCHOR, TREND, VERDICT, LoggedFrame, LoggedRun, is_recording

VALUES = "decision_values"
NOT_SHOWN = "its pictures are not there"
CHANGED = "its pictures are not those that were judged"
BEFORE = "what came before it is not known"


def judged_picture(
    mission: Mission, number: int, camera: str, pixel_format: str | None, mark: str
) -> tuple[U8 | None, str]:
    """The picture of a frame whose log has this mark, or why it is not shown."""
    picture, _ = read_picture(mission, number, camera, pixel_format)
    if picture is None:
        return None, NOT_SHOWN
    return (picture, "") if pixel_mark(picture) == mark else (None, CHANGED)


def pictures_of(
    log: Path, run: str, start: RunStart | None, source: Path | None
) -> tuple[Mission, str | None]:
    """Where a run's pictures are, and how they hold pixels: a recording, as they were judged.

    They are in `source`, beside a recording's own log, where the run had them from, or in its
    recording; ToktError if they are not there.
    """
    place = source or (log if is_recording(log) else None)
    if place is None:
        known = start and (Path(start.source), Path(start.record or start.source, run))
        place = next((each for each in known or () if each.exists()), None)
    if place is None:
        raise ToktError(
            f"the pictures of {start.source if start else run} are not there: say where they are, "
            "or where a recording of the run is (--source FOLDER)"
        )
    raw = None if start is None or is_recording(place) else start.pixel_format
    return open_mission(place), raw


def odometry_of(start: RunStart) -> Odometry | None:
    """The poses that a run was given, None if none; ToktError if their file is another now."""
    then = start.odometry
    if then is None:
        return None
    path = Path(then.path)
    if used_file(path).sha256 != then.sha256:
        raise ToktError(f"odometry {path} is not the one that the run had")
    return load_odometry(path)


@dataclass(frozen=True)
class Replay:
    """A logged run, and what its frames are judged again with."""

    run: LoggedRun
    mission: Mission  # where its pictures are
    pixel_format: str | None  # how they hold them, as in `sources.files.MissionSource`
    stereo: StereoSetup | None  # how pairs are looked at
    models: Mapping[str, Bundle]  # the run's own, by their bundles' SHA-256
    other: Bundle | None = None  # what judges every frame instead of them

    def frames(self) -> Iterator[Compared]:
        """Judge each frame and compare.

        ToktError if the run's policy cannot be put together, or its log cannot be read.
        """
        stopwatch = FixedStopwatch()  # what the run's own took
        assembly = self._assembly(stopwatch)
        moving_s = 0.0 if self.run.start.moving is None else REMEMBERED_S
        history = _History(_window(assembly), HORIZON_S + moving_s)
        exchanged = 0
        for logged in self.run.frames():
            if self.other is None and logged.model is not None and logged.exchanged != exchanged:
                if assembly.texture is None:
                    words = "a model was exchanged where the policy has none"
                    raise ToktError(f"{self.run.path}: {words}")
                model = self._as_it_ran(self.models[logged.model.sha256])
                assembly.texture.put(TextureDetector(model, sight=assembly.sight))
                history.begin_model(_window(assembly))
            exchanged = logged.exchanged
            if logged.named is not None:
                assembly.policy.tracker = self._named(logged.named)
            frame, why_not = self._shown(logged)
            history.take_in(logged, shown=frame is not None)
            if frame is None:
                yield Compared(logged, None, None, why_not)
                continue
            if history.broken:  # the detectors are told of the gap
                frame = replace(frame, missed=MANY_MISSED)
            stopwatch.seconds = logged.texture_s or 0.0
            judgement = assembly.policy.judge(frame)
            yield self._compared(logged, judgement, history, assembly)

    def _assembly(self, stopwatch: FixedStopwatch) -> Assembly:
        start = self.run.start
        load: Callable[[], Bundle] | None = self._first_model
        if self.other is None and start.model is None and not start.model_fault:
            load = None
        anchor = None if start.anchor is None else Anchor(start.anchor)
        assembly = assemble(
            name=start.policy,
            load_model=load,
            stereo=self.stereo,
            stopwatch=stopwatch,
            anchor=anchor,
            moving=start.moving,
            stereo_fault=start.stereo_fault,
            alone=bool(start.model_fault),
        )
        if assembly.texture is not None:
            assembly.texture.note = start.model_note
        return assembly

    @cached_property
    def _masks(self) -> CameraMasks | None:
        """What was no view in the run; ToktError if its log has no such thing."""
        masks = self.run.start.masks
        return CameraMasks.from_json(masks) if masks else None

    def _named(self, event: Mapping[str, Any]) -> ObjectTracker | None:
        """What holds the object of an event; None without its picture."""
        try:
            detail = detail_picture(named_picture(event["frame"], self.mission, self.pixel_format))
            model = ObjectModel(detail, event["box"])
        except (ToktError, KeyError, TypeError, ValueError):
            return None
        return ObjectTracker(model) if pixel_mark(detail) == event.get("mark") else None

    def _first_model(self) -> Bundle:
        if self.other is not None:
            return self._as_it_ran(self.other)
        start = self.run.start
        if start.model is None:
            raise ToktError(start.model_fault)
        return self._as_it_ran(self.models[start.model.sha256])

    def _as_it_ran(self, model: Bundle) -> Bundle:
        """With the boundary and the sight as the run's options had them."""
        start = self.run.start
        if start.sight is not None:
            model = model.with_sight(sight_from_json(start.sight))
        return model.with_fixed_boundary() if start.fixed_boundary else model

    def _shown(self, logged: LoggedFrame) -> tuple[Frame | None, str]:
        """The frame as the policy saw it, or why it cannot be shown again."""
        pictures: list[tuple[U8 | None, Fault]] = []
        for camera, then in ((LEFT, logged.left), (RIGHT, logged.right)):
            if isinstance(then, Fault):
                pictures.append((None, then))
                continue
            where = self.mission, logged.number, camera, self.pixel_format
            picture, why_not = judged_picture(*where, then)
            if picture is None:
                return None, why_not
            pictures.append((picture, NO_FAULT))
        (left, left_fault), (right, right_fault) = pictures
        views = left, right, left_fault, right_fault
        frame = Frame(logged.number, logged.t, *views, logged.missed, timed=logged.timed)
        return replace(frame, masks=self._masks), ""

    def _compared(
        self, logged: LoggedFrame, judgement: Judgement, known: _History, assembly: Assembly
    ) -> Compared:
        fields = self._fields(logged, judgement)
        # Whoever judges has another name and other words for it; that is no other verdict.
        left_out = () if self.other is None else ("model", "health")
        if not known.since_start and (assembly.stereo is not None or not known.for_trend):
            left_out = (*left_out, *TREND)
        if logged.verdict.get("anchor") and not (known.since_start and fields["anchor"]):
            left_out = (*left_out, *ANCHOR)
        compared = [name for name in logged.verdict if name not in left_out]
        differs = [name for name in compared if not _same(name, fields[name], logged.verdict[name])]
        if logged.has_values and self.other is None:
            values = json_values(judgement.decision_values)
            differs += [VALUES] * (repr(values) != repr(logged.values))
        by_dive = {fields["reason"], logged.verdict["reason"]} & {Reason.MOVING, Reason.SEDIMENT}
        by_texture = fields["method"] == logged.verdict["method"] == TEXTURE
        enough = known.since_start or (
            known.for_texture
            and not by_dive  # it hangs on what the water looked like long before
            and (assembly.stereo is None or (by_texture and self.run.start.policy == "fallback"))
        )
        return Compared(logged, fields, tuple(differs), "" if enough else BEFORE)

    def _fields(self, logged: LoggedFrame, judgement: Judgement) -> dict[str, Any]:
        """The verdict's fields as they would have been logged."""
        start = self.run.start
        verdict = mark_overloaded(judgement.verdict, logged.left_out)
        if start.live and logged.age_s is not None:
            judging_s = logged.judging_s or 0.0
            verdict = mark_stale(verdict, logged.age_s, judging_s, start.limits.stale_s)
        report = Report(logged.seq, logged.number, logged.t, None, verdict)
        return {name: value for name, value in report.fields().items() if name in VERDICT}


def _same(name: str, replayed: Any, logged: Any) -> bool:
    """Whether a field is the same to the last bit.

    Of health the order of its words is none, and a part that was not working is no verdict's.
    """
    if name == "health":
        words = [word for word in str(logged).split("; ") if not word.startswith(WITHOUT)]
        return sorted(str(replayed).split("; ")) == sorted(words or [HEALTHY])
    return repr(replayed) == repr(logged)


@dataclass(frozen=True)
class Compared:
    """One frame, then and now."""

    logged: LoggedFrame
    replayed: Mapping[str, Any] | None  # `VERDICT`'s fields; None where it could not be shown again
    differs: tuple[str, ...] | None  # fields not the same to the last bit; `VALUES` among them
    why_not: str = ""  # why the frame is not counted; empty where it is


class _History:
    """What is known of what came before a frame, which is counted in places.

    That is every frame of the run (`since_start`), as many as the model's frame rule looks at
    (`for_texture`), or as a trend does (`for_trend`). It is `broken` for the first one after frames
    that are not known.
    """

    def __init__(self, window: int, horizon_s: float) -> None:
        self.begin_model(window)
        self._horizon_s = horizon_s
        self.since_start = self._shown = True

    def begin_model(self, window: int) -> None:
        """Another model, which knows of no frame before."""
        self._window = window
        self._places = math.inf
        self._since_s = -math.inf

    def take_in(self, logged: LoggedFrame, shown: bool) -> None:
        """Tell of what is before this frame; whether it is shown is for those after it."""
        self.broken = not (self._shown and logged.follows)
        if self.broken:
            self.since_start, self._places, self._since_s = False, 0, logged.t
        places = self._places + logged.missed
        self._places, self._shown = places + 1, shown
        self.for_texture = places >= self._window - 1
        self.for_trend = logged.t - self._since_s >= self._horizon_s


def _window(assembly: Assembly) -> int:
    """Frames that the model looks at: its rule, and its state of the water."""
    detector = None if assembly.texture is None else assembly.texture.detector
    if not isinstance(detector, TextureDetector):
        return 1
    return detector.window_frames


@dataclass
class ReplayStretch:
    """Frames in a row that differ alike, by their statuses and reasons then and now."""

    first: int
    last: int
    frames: int
    logged: tuple[int, str]
    replayed: tuple[int, str]
    fields: list[str]  # what differs in at least one of them
    example: dict[str, list[Any]]  # of the first frame: what differs, then and now

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form, statuses in words."""
        ends = {
            name: {"status": STATUS_WORDS[status], "reason": reason}
            for name, (status, reason) in (("logged", self.logged), ("replayed", self.replayed))
        }
        return {**vars(self), **ends}


@dataclass
class Tally:
    """Counts over a replay's frames."""

    statuses: Counter[tuple[int, int]] = field(default_factory=Counter)  # logged, replayed
    same: int = 0  # to the last bit
    status_differs: int = 0  # another status
    figures_differ: int = 0  # the same status, another figure or word
    not_compared: Counter[str] = field(default_factory=Counter)  # by why not
    alike_all_the_same: int = 0  # of those not compared
    gaps: int = 0  # frames before which lines or frames are missing
    stretches: list[ReplayStretch] = field(default_factory=list)
    _open: bool = False

    @property
    def compared(self) -> int:
        """Frames that are compared."""
        return self.same + self.status_differs + self.figures_differ

    @property
    def agrees(self) -> bool:
        """Whether every picture is the one that was judged, and every verdict the same."""
        changed = self.not_compared[CHANGED] + self.not_compared[NOT_SHOWN]
        return self.compared == self.same and not changed

    def add(self, frame: Compared) -> None:
        """Count one frame."""
        self.gaps += not frame.logged.follows
        if frame.why_not or frame.replayed is None or frame.differs is None:
            self.not_compared[frame.why_not] += 1
            self.alike_all_the_same += frame.differs == ()
            self._open = False
            return
        then, now = frame.logged.verdict, frame.replayed
        self.statuses[then["status"], now["status"]] += 1
        if not frame.differs:
            self.same += 1
            self._open = False
            return
        if then["status"] != now["status"]:
            self.status_differs += 1
        else:
            self.figures_differ += 1
        self._stretch(frame, now, frame.differs)

    def _stretch(self, frame: Compared, now: Mapping[str, Any], differs: tuple[str, ...]) -> None:
        then, number = frame.logged.verdict, frame.logged.number
        ends = (then["status"], then["reason"]), (now["status"], now["reason"])
        newest = self.stretches[-1] if self._open else None
        if newest is not None and (newest.logged, newest.replayed) == ends:
            newest.last, newest.frames = number, newest.frames + 1
            newest.fields += [name for name in differs if name not in newest.fields]
            return
        # Decision values are hundreds of numbers: that they differ is enough here.
        example = {name: [then[name], now[name]] for name in differs if name in now}
        self.stretches.append(ReplayStretch(number, number, 1, *ends, list(differs), example))
        self._open = True

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            "same": self.agrees,
            "compared": self.compared,
            "same_to_the_bit": self.same,
            "status_differs": self.status_differs,
            "figures_differ": self.figures_differ,
            "not_compared": dict(self.not_compared),
            "not_compared_but_alike": self.alike_all_the_same,
            "gaps": self.gaps,
            "statuses": status_table(self.statuses),
            "differences": [stretch.to_json() for stretch in self.stretches],
        }


def models_of_run(run: LoggedRun, store: Path | None = None) -> dict[str, Bundle]:
    """Every model that judged in a run, by SHA-256, of `store` or where the run had them from.

    ToktError as of `model_of`.
    """
    place = store or (Path(run.start.models_from) if run.start.models_from else None)
    return {name.sha256: model_of(name, place) for name in run.models}


def model_named(place: Path) -> Bundle:
    """Read the model of a bundle file, the active one of a store, or one that comes with tokt.

    Raises ToktError if there is none, or it fails its checks.
    """
    if is_packaged(place) and not place.exists():
        return read_bundle(packaged_bundle(str(place)))
    return Store(place).active() if place.is_dir() else read_bundle(place)


def model_of(name: ModelName, place: Path | None) -> Bundle:
    """The model of this name, of a bundle file or store; ToktError if it is gone or unsound."""
    if place is None:
        raise ToktError(f"the log does not say where model {name.label} is (--store STORE)")
    if place.is_dir():
        return Store(place).bundle(name.sha256)
    bundle = read_bundle(place)
    if bundle.sha256 != name.sha256:
        raise ToktError(
            f"{place} is not the bundle that ran: it is {bundle.label} {bundle.sha256[:12]}, the "
            f"run's was {name.label} {name.sha256[:12]} (--bundle {place} judges with it all the "
            "same)"
        )
    return bundle
