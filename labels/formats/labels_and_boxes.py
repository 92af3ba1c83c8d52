"""Labels of patches become boxes on their frames, and boxes of any file become labels.

A box that is a patch of ours, by the attributes it carries and by its place, becomes that
patch's label as it was. Any other box or polygon gives its class to each patch that it covers by
half or more; where several do, the one that covers most decides, and of equal ones the last. A
point gives its class to the patch that it is in, unless a box decides there; a patch whose points
differ is left out.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, TypeVar

from tokt.features.common.errors import FrameError, ToktError
from tokt.features.common.names import same_text
from tokt.labels.record import HUMAN, MODEL, SETTLED, Cell, LabelRecord, utc_now
from tokt.labels.taxonomy import UNSURE, UnknownClassError

from .box_attributes import (
    READ,
    changed_by_hand,
    from_attributes,
    is_turned,
    is_unverified,
    size_of,
)
from .boxes import Box, Shape, Size, found_shape, patch_box
from .images import FrameKey, MissionImages
from .options import (
    ImportResult,
    ReadOptions,
    Remarks,
    WriteOptions,
    count,
    in_order,
    mission_images,
)

T = TypeVar("T")
_FOLDERS = 3  # of other dives that a remark names
PERCENT = Size(100, 100)
"""The size of a picture in which shapes in percent are pixels."""
_SHOWN = 100  # characters of a file's own words that a remark repeats


@dataclass(frozen=True)
class FrameLabels:
    """One frame's labels and the boxes of their patches, in order of row, column, annotator."""

    key: FrameKey
    name: str
    size: Size
    labels: list[tuple[LabelRecord, Box]]


def labels_to_boxes(
    records: Iterable[LabelRecord], options: WriteOptions, remarks: Remarks, what: str
) -> list[FrameLabels]:
    """Labels by frame; remarks tell of those that cannot be placed.

    Raises ToktError if there are no frames, labels of several missions, or none that can be placed.
    """
    images = mission_images(options, f"{what} needs file names and sizes of frames")
    frames: list[FrameLabels] = []
    for key, size, mine in seen_frames(records, options, remarks, what, images.size):
        name = images.file_name(key) or ""
        if any("\ud800" <= sign <= "\udfff" for sign in name):  # as Python reads such bytes
            remarks["label", "left out: the name of their file is not UTF-8"] += len(mine)
            continue
        boxes = [(record, patch_box(record.grid, size, record.row, record.col)) for record in mine]
        frames.append(FrameLabels(key, name, size, boxes))
    if not frames:
        raise ToktError("; ".join(["no label could be written", *remarks.lines()]))
    return frames


def seen_frames(
    records: Iterable[LabelRecord],
    options: WriteOptions,
    remarks: Remarks,
    what: str,
    look: Callable[[FrameKey], T],
) -> Iterator[tuple[FrameKey, T, list[LabelRecord]]]:
    """Labels of one mission by frame, sorted, each with what `look` gives of the frame."""
    chosen = in_order(records)
    missions = sorted({record.mission for record in chosen})
    if len(missions) > 1:
        raise ToktError(
            f"labels of missions {', '.join(missions)}: {what} is written for one; choose it by"
            " --mission NAME"
        )
    images = mission_images(options, what)
    groups = [(key, list(mine)) for key, mine in groupby(chosen, _key)]
    for key, mine in options.progress(groups, len(groups), "frames"):
        if images.file_name(key) is None:
            remarks["label", f"left out: {images.mission.path} has no such frames"] += len(mine)
            continue
        try:
            seen = look(key)
        except FrameError:
            remarks["label", "left out: their frames cannot be read"] += len(mine)
            continue
        yield key, seen, mine


def one_label_a_patch(
    records: Iterable[LabelRecord], remarks: Remarks, what: str
) -> list[LabelRecord]:
    """The labels, of a settled patch the settlement; ToktError where two people said something."""
    chosen: dict[Cell, LabelRecord] = {}
    for record in sorted(records, key=lambda r: (r.source != SETTLED, r.annotator)):
        first = chosen.setdefault(record.cell, record)
        if first is record:
            continue
        if first.source != SETTLED:
            raise ToktError(
                f"{record.cell} is labelled by {first.annotator} and by {record.annotator}: {what}"
                " holds one label a patch; choose by --annotator"
            )
        remarks["opinion", "on patches that were settled"] += 1
    return list(chosen.values())


def without_suggestions(
    records: Iterable[LabelRecord], remarks: Remarks, title: str
) -> list[LabelRecord]:
    """The labels without the suggestions of models, which a format would take for labels."""
    chosen = list(records)
    kept = [record for record in chosen if record.source != MODEL]
    remark = f"of models left out: in {title} they would count as labels"
    remarks["suggestion", remark] += len(chosen) - len(kept)
    return kept


def short_names(frames: Iterable[FrameLabels]) -> dict[FrameKey, str]:
    """File names without the camera's folder, where that tells the frames apart."""
    names = {frame.key: (frame.name.rpartition("/")[2], frame.name) for frame in frames}
    times = Counter(short for short, _ in names.values())
    return {key: name if times[short] > 1 else short for key, (short, name) in names.items()}


@dataclass(frozen=True)
class FoundBox:
    """A shape with a class, as a file says it; None is what it does not say."""

    where: str  # the place in the file, for error messages
    image: str  # what the file calls the frame; may be empty where `position` is given
    shape: Shape  # in pixels of a frame of `size`
    label: str  # the class as the file calls it
    annotator: str  # who said it, where the attributes do not say
    attributes: Any = None  # what it has in the place of free ones, among which may be ours
    size: Size | None = None  # the frame's
    time: str | None = None  # when it was said
    model_version: str | None = None  # where no person said it, but it is a model's suggestion
    position: int | None = None  # the frame's in its camera's sequence, from 0
    time_s: float | None = None  # the frame's in a video, from its start
    in_whole_seconds: bool = False  # that time, so that a position beside it is more exact
    rate: float | None = None  # frames a second that the file counts its positions at
    in_percent: bool = False  # the shape, in place of pixels
    image_id: str = ""  # what tells the image apart in the file, such as "image 7"


def known_shape(kind: str, numbers: Sequence[float], remarks: Remarks) -> Shape | None:
    """As `found_shape`; remarks tell of what is none."""
    shape = found_shape(kind, numbers)
    if shape is None:
        remarks["shape", f"left out: {kind[:20]!r} with {len(numbers)} numbers"] += 1
    return shape


def boxes_to_labels(
    boxes: Iterable[FoundBox], options: ReadOptions, remarks: Remarks
) -> ImportResult:
    """The labels that boxes are.

    `remarks` has what the reader of the file itself left out.

    Raises ToktError if a class is not known, a box says what cannot be, or boxes need the mission's
    frames and these are not given or are other ones.
    """
    found = list(boxes)
    classes = class_names((box.label for box in found), options)
    labels = _LabelCollector(options, remarks)
    for box in found:
        label = classes[box.label]
        if not label:
            remarks[box.shape.noun, f"left out by --map: class {box.label!r}"] += 1
            continue
        try:
            labels.add(box, label)
        except ToktError as error:
            remarks.leave_out(box.where, error)
    remarks.refuse_mostly_odd()
    return labels.result()


def class_names(names: Iterable[str], options: ReadOptions) -> dict[str, str]:
    """The file's class names and what they are here; nothing for what is left out.

    Raises ToktError if one is no class and not mapped to one; names them all.
    """
    counts = Counter(names)
    same = {name: same_text(name) for name in counts}
    found = {name: options.classes.get(same[name], same[name]) for name in counts}
    known = (*options.taxonomy.names, UNSURE)
    unknown = [name for name, ours in found.items() if ours and ours not in known]
    unknown += [
        name for name, ours in found.items() if not ours and same[name] not in options.classes
    ]
    if unknown:
        which = ", ".join(f"{name!r} ({counts[name]})" for name in sorted(unknown)[:10])
        more = ", ..." if len(unknown) > 10 else ""
        raise UnknownClassError(
            f"unknown class {which}{more}; known: {', '.join(known)}; map it by --map THEIRS=OURS"
            " (--map THEIRS= leaves it out) or add it to the taxonomy",
            unknown,
        )
    return found


class _LabelCollector:
    """Collects labels; of several for one patch by one annotator one stays."""

    def __init__(self, options: ReadOptions, remarks: Remarks) -> None:
        self._remarks = remarks
        self._options = options
        self._now = utc_now()
        self._best: dict[tuple[Cell, str, str], tuple[float, LabelRecord, bool]] = {}
        self._contested: set[tuple[Cell, str, str]] = set()
        self._mixed: set[tuple[Cell, str, str]] = set()
        self._missing: Counter[str] = Counter()
        self._foreign: Counter[str] = Counter()
        self._names: dict[FrameKey, dict[tuple[str, str], None]] = {}
        # Frames with boxes whose picture's size the file does not say, and those of them on which
        # a shape shows that it was another one than the frame's.
        self._unsized: dict[FrameKey, int] = Counter()
        self._larger: dict[FrameKey, str] = {}

    def add(self, found: FoundBox, label: str) -> None:
        """Take over one box."""
        shape, carried = found.shape, from_attributes(found.attributes)
        if shape.is_empty:
            self._remarks[shape.noun, "left out: without area"] += 1
        elif is_turned(found.attributes):
            self._remarks[shape.noun, "left out: turned"] += 1
        elif carried is None:
            self._add_foreign(found, label)
        elif placed := self._placed(found, self._key_of(carried, found), carried.mission):
            shape, size = placed
            who = self._options.annotator, found.annotator
            if not shape.is_of_patch(carried.grid, size, carried.row, carried.col):
                remark = "moved since tokt wrote the file: read by its new place"
                self._remarks[shape.noun, remark] += 1
                self._spread(shape, size, changed_by_hand(carried, label, *who))
            elif same_text(found.label) != carried.label:
                remark = "of another class than tokt wrote: labels by hand"
                self._remarks[shape.noun, remark] += 1
                self._keep(1.0, changed_by_hand(carried, label, *who))
            else:
                same = label == carried.label
                self._keep(1.0, carried if same else replace(carried, label=label))

    def _key_of(self, carried: LabelRecord, found: FoundBox) -> FrameKey:
        """The frame of a box of ours; ToktError where the file gives the box to another one."""
        key, images = FrameKey(carried.camera, carried.frame), self._options.images
        if images is not None and carried.mission == images.name:
            named = images.find(found.image)
            if named.folder or named.key not in (None, key):
                raise ToktError(
                    f"on image {found.image[:_SHOWN]!r}, and by what tokt wrote into it on"
                    f" {carried.camera} frame {carried.frame} of {carried.mission}"
                )
            file = images.mission.file_name(key.frame, key.camera) or carried.file
            if carried.file and Path(carried.file).stem != Path(file).stem:
                raise ToktError(f"of file {carried.file[:_SHOWN]!r}, and that frame is {file!r}")
        return key

    def _placed(self, found: FoundBox, key: FrameKey, mission: str) -> tuple[Shape, Size] | None:
        """The shape in pixels of the frame, and the frame's size; None where it has no place."""
        said, size = found.size or size_of(found.attributes), None
        images = self._options.images
        if said is None:
            images = mission_images(self._options, "boxes without the size of their frame")
        if images is not None and images.name == mission:
            try:
                size = images.size(key)
            except FrameError:  # then it is what the file says, if it does
                if said is None:
                    raise
        size = size or said
        if size is None:
            raise ToktError(
                f"no size, and it is of mission {mission!r}: give that mission's frames"
            )
        if found.in_percent:
            return found.shape.scaled(PERCENT, size), size
        if said in (None, size):
            return found.shape, size
        noun, told = found.shape.noun, f"of pictures of {said}, where frames have {size}"
        if not size.is_like(said):
            self._remarks[noun, f"left out: {told}"] += 1
            return None
        self._remarks[noun, f"{told}: scaled"] += 1
        return found.shape.scaled(said, size), size

    def _add_foreign(self, found: FoundBox, label: str) -> None:
        images = mission_images(self._options, "boxes that are not patches of tokt")
        key = self._frame_of(found, images)
        if key is None:
            return
        placed = self._placed(found, key, images.name)
        if placed is None:
            return
        if isinstance(found.attributes, Mapping):
            self._remarks.pass_over(map(str, found.attributes), READ)
        version = found.model_version
        if version is None and is_unverified(found.attributes):
            version = found.annotator
        if version is not None:
            self._remarks[found.shape.noun, "of a model: suggestions, not labels"] += 1
        base = LabelRecord(
            *(images.name, key.camera, key.frame, self._options.grid, 0, 0, label),
            found.annotator,
            found.time or self._now,
            HUMAN if version is None else MODEL,
            version,
            file=images.mission.file_name(key.frame, key.camera) or "",
        )
        if found.size is None and not found.in_percent:
            self._unsized[key] += 1
            if placed[0].is_beyond(placed[1]):
                corner = f"({found.shape.box.x1:g}, {found.shape.box.y1:g})"
                self._larger.setdefault(key, f"{found.where} at {corner} px, frame {placed[1]}")
        self._spread(*placed, base, sized=found.size is not None or found.in_percent)

    def _frame_of(self, found: FoundBox, images: MissionImages) -> FrameKey | None:
        """The frame that a box is on; None where it is none of the mission, which is counted."""
        named, key = images.find(found.image), None
        if named.key is None and not named.folder and (images.is_video or not found.image):
            position = _position(found, images.frames_per_second)
            if position != found.position:
                remark = "placed by time: the file's frame numbers are of another rate"
                self._remarks[found.shape.noun, remark] += 1
            key = None if position is None else images.at(self._options.camera, position)
        key = key or named.key
        if named.folder:
            self._foreign[named.folder] += 1
        elif key is None:
            self._missing[found.image or f"position {found.position}"] += 1
        elif named.key is not None:
            name = same_text(found.image), found.image_id
            self._names.setdefault(key, {})[name] = None
            if named.remark:
                self._remarks["box", f"on images {named.remark}"] += 1
        return key

    def _spread(self, shape: Shape, size: Size, said: LabelRecord, *, sized: bool = True) -> None:
        """Give what was said to each patch that is found in the shape."""
        patches = shape.patches(said.grid, size)
        if shape.box.is_outside(size):
            self._remarks[shape.noun, "left out: outside the frame"] += 1
        elif not patches:
            what = "in no patch" if shape.noun == "point" else "covering no patch by half"
            self._remarks[shape.noun, f"left out: {what}"] += 1
        for row, col, share in patches:
            self._keep(share, replace(said, row=row, col=col), sized)

    def _keep(self, share: float, record: LabelRecord, sized: bool = True) -> None:
        settled = record.source == SETTLED  # once a patch, whoever did it
        key = (record.cell, "" if settled else record.annotator, record.source)
        best = self._best.get(key)
        if best and best[1].label != record.label:
            (self._contested if share or best[0] else self._mixed).add(key)
        if best is None or share >= best[0]:
            self._best[key] = (share, record, sized)

    def result(self) -> ImportResult:
        """The labels, and what was not taken over."""
        remarks = self._remarks
        self._refuse_two_names()
        remarks[
            "patch",
            "under boxes of several classes: the box that covers most decided, of equal ones the"
            " last",
        ] += len(self._contested)
        mixed = {key for key in self._mixed if not self._best[key][0]}
        remarks["patch", "left out: points of several classes"] += len(mixed)
        self._tell_foreign()
        # Where it shows on half of the frames, all pictures of the file were larger.
        all_were = 2 * len(self._larger) >= len(self._unsized)
        larger = set(self._unsized if self._larger and all_were else self._larger)
        if larger:
            images, seen = count(len(larger), "frame"), next(iter(self._larger.values()))
            what = f"left out: on {images} whose pictures were larger where they were labelled"
            remarks["box", f"{what} ({seen})"] += sum(self._unsized[key] for key in larger)
        if self._missing:
            first = next(iter(self._missing))
            images = count(len(self._missing), "image")
            what = f"left out: on {images} not of the mission, such as {first[:_SHOWN]!r}"
            remarks["box", what] += sum(self._missing.values())
        # A settlement answers the opinions, so it comes after them.
        records = sorted(
            (
                record
                for key, (_, record, sized) in self._best.items()
                if key not in mixed and (sized or _key(record) not in larger)
            ),
            key=lambda r: r.source == SETTLED,
        )
        if not records:
            raise ToktError("; ".join(["no labels in it", *remarks.lines()]))
        return ImportResult(records, remarks.lines())

    def _refuse_two_names(self) -> None:
        for key, names in self._names.items():
            if len(names) > 1:
                one, other, *_ = (
                    f"{image[:_SHOWN]!r}{f' ({number})' if number else ''}"
                    for image, number in names
                )
                raise ToktError(
                    f"images {one} and {other} are both {key.camera} frame {key.frame}: keep one of"
                    " them in the file, or import each from a file of its own"
                )

    def _tell_foreign(self) -> None:
        """Tell of boxes in folders of other dives; ToktError where these are all there are."""
        images = self._options.images
        if images is None or not self._foreign:
            return
        folders = ", ".join(map(repr, [*self._foreign][:_FOLDERS]))
        if not self._names:
            raise ToktError(
                f"its images are in {folders}, and the frames given are those of {images.name!r}."
                " Give that dive's frames by --mission-dir; or say by --folder NAME what the file"
                " calls this one"
            )
        what = f"left out: in {folders}, which is another dive than {images.name!r}"
        self._remarks["box", what] += sum(self._foreign.values())


def _position(found: FoundBox, video_rate: float | None) -> int | None:
    """The position of a box's frame in a video, by its time where it has one."""
    if video_rate is None or found.position is None:
        return found.position
    seconds, time_s = found.position / (found.rate or video_rate), found.time_s
    # A time in whole seconds does not tell which of the frames in that second it is.
    within = found.in_whole_seconds and time_s is not None and 0 <= seconds - time_s < 1
    return round(video_rate * (seconds if within or time_s is None else time_s))


def _key(record: LabelRecord) -> FrameKey:
    return FrameKey(record.camera, record.frame)
