"""Inputs of a study: frames, labels, the thesis's models, cameras; each read once."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.image_file import read_image
from tokt.features.frames.mission import LEFT, RIGHT, Mission, open_mission
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.carried_labels import LabelCarrier
from tokt.labels.formats.options import Progress
from tokt.labels.merge import merge_annotators
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.training.calibration.any_form import read_calibration_file
from tokt.training.datasets.mission_source import labels_of_mission, read_labels
from tokt.training.fitting.train import rendered_other_image
from tokt.training.options import Notice
from tokt.training.rig.calibrate.frame_selection import MIN_SHARE, evenly_spaced, texture
from tokt.training.rig.calibrate.self_calibration import BASELINE_MM, plain_start, self_calibrate
from tokt_studies.baselines.thesis_models import ThesisModel, TrainingImage, thesis_model
from tokt_studies.baselines.thesis_texture import DESCRIBE, GRID

from .patch_scores import Truth

LABEL_FILE, CALIBRATION_FILE = "labels.csv", "calibration.yml"
UNKNOWN: Truth = np.full(GRID.n_patches, -1, np.int8)
SURVEYED = 80
"""Pairs looked at for something in them, spread over the mission."""


@dataclass(frozen=True)
class ReproduceRequest:
    """The options of ``tokt reproduce``."""

    mission: Path
    out: Path
    ocean: Path | None = None  # the thesis's training image; by default an early frame
    other: Path | None = None  # the one of anything else; by default a rendered texture
    picture: Path | None = None  # in bad light; by default a rendered pair
    picture_mask: Path | None = None  # a person's mask of what is in it (white: obstacle)
    camera: str = LEFT  # whose frames the texture methods judge
    calibration: Path | None = None  # of the cameras
    labels: Path | None = None  # a label file of the mission
    model: Path | None = None  # a bundle
    sample: int = 12  # frames, spread over the mission, for what is too slow for all (SLIC)
    jobs: int = -1  # processes; -1 for one a core. No figure but a time depends on it.


class StudyInputs:
    """Inputs of the exhibits; each is read or computed when first asked for, and once.

    `say` takes a line for people, and ``progress(items, total, what)`` passes items on; `frames`
    are those of the request's camera, in order. Raises ToktError if the mission or a file of the
    request cannot be used.
    """

    def __init__(self, request: ReproduceRequest, say: Notice, progress: Progress) -> None:
        self.request = request
        self.say = say
        self.progress = progress
        self.mission: Mission = open_mission(request.mission)
        if request.camera not in self.mission.cameras:
            there = ", ".join(self.mission.cameras)
            raise ToktError(
                f"mission {self.mission.name} has no camera {request.camera!r}: {there}"
            )
        self.frames = self.mission.frames(request.camera)
        self.taxonomy = Taxonomy.load()
        for file in (request.picture, request.picture_mask, request.model):
            if file is not None and not file.is_file():
                raise ToktError(f"{file} does not exist")
        if request.sample < 1:
            raise ToktError(f"--sample is a number of frames, 1 or more, not {request.sample}")

    def left(self, number: int) -> U8:
        """A left frame as decoded: uint8, gray or BGR. Raises FrameError if it cannot be read."""
        return self.mission.read(number, LEFT)

    def picture(self, number: int) -> U8:
        """A frame of the camera that texture methods look through; as `left`."""
        return self.mission.read(number, self.request.camera)

    def any_picture(self) -> U8:
        """The first of these that can be read. Raises ToktError if none can."""
        return self._first(self.frames)[1]

    def _first(self, numbers: Sequence[int]) -> tuple[int, U8]:
        for number, image in self.decoded(numbers):
            return number, image
        raise ToktError(f"mission {self.mission.name}: no {self.request.camera} frame can be read")

    def right(self, number: int) -> U8 | None:
        """A right frame as decoded, or None where there is none that can be read."""
        if RIGHT not in self.mission.cameras:
            return None
        try:
            return self.mission.read(number, RIGHT)
        except FrameError:
            return None

    @cached_property
    def pairs(self) -> list[int]:
        """Numbers that both cameras have a frame of, in order."""
        return sorted(set(self.mission.frames(LEFT)) & set(self.mission.frames(RIGHT)))

    @cached_property
    def textured_pairs(self) -> list[int]:
        """Of `SURVEYED` pairs those that show something: most of a dive is open water."""
        return [number for number, share in self._textures.items() if share >= MIN_SHARE]

    @cached_property
    def open_water_pairs(self) -> list[int]:
        """Of `SURVEYED` pairs those whose left picture has no local contrast at all."""
        return [number for number, share in self._textures.items() if share == 0]

    @cached_property
    def _textures(self) -> dict[int, float]:
        return {n: texture(self.mission, n) for n in evenly_spaced(self.pairs, SURVEYED)}

    @cached_property
    def labels(self) -> list[LabelRecord] | None:
        """What is known of the frames' patches: one record a patch, annotators merged.

        From the file of the request, or ``labels.csv`` in the mission's folder or beside it; None
        where there is neither. Records of `unsure` are among them. A right camera without any has
        the left one's, as far as the calibration can carry them.
        """
        return self.carried_labels or self._labels_of(self.request.camera)

    def _labels_of(self, camera: str) -> list[LabelRecord] | None:
        every = self._all_labels
        return every and [one for one in every if one.camera == camera]

    @cached_property
    def carried_labels(self) -> list[LabelRecord]:
        """The left frames' labels in the right ones of the same moments; none where it has some."""
        left, found = self._labels_of(LEFT), []
        if not left or self._labels_of(self.request.camera):
            return []
        classes = self.taxonomy.classes
        clear, other = (next(c.name for c in classes if c.obstacle is one) for one in (False, True))
        try:
            carrier = LabelCarrier(self.needed_calibration(), GRID)
            for number, right in self.decoded([n for n in self.pairs if n in self.left_labelled]):
                labels = [(clear, other, None)[code] for code in self.left_labelled[number]]
                there = carrier.carry(self.left(number), right, labels, [clear])
                for patch, sure in enumerate(carrier.sure_clear(labels, [clear])):
                    if label := clear if sure else there[patch]:
                        at = replace(left[0], row=patch // GRID.cols, col=patch % GRID.cols)
                        found.append(replace(at, camera=RIGHT, frame=number, label=label))
        except ToktError as error:
            self.say(f"no labels of right frames, nor carried from left ones: {error}")
            return []
        return found

    @cached_property
    def _all_labels(self) -> list[LabelRecord] | None:
        if not self.mission.path.is_dir() and self.request.labels is None:
            return None
        places = (self.mission.path, self.mission.path.parent)
        beside = [at / LABEL_FILE for at in places if (at / LABEL_FILE).is_file()]
        file = self.request.labels or next(iter(beside), None)
        if file is None:
            return None
        try:
            given = read_labels([file], self.taxonomy, GRID)
            mine, remark = labels_of_mission(self.mission, given, GRID, only=True)
        except ToktError:
            # A file that lies beside the mission by chance is no reason to refuse it.
            if self.request.labels is None and file.parent != self.mission.path:
                return None
            raise
        if remark:
            self.say(remark)
        return merge_annotators(mine).records

    @cached_property
    def labelled(self) -> dict[int, Truth]:
        """Labels of the patches of every frame that has a label that is sure, in order."""
        return self._truths_of(self.labels)

    @cached_property
    def left_labelled(self) -> dict[int, Truth]:
        """The same of left frames, for what is made of the pair."""
        return self._truths_of(self._labels_of(LEFT))

    def _truths_of(self, records: Sequence[LabelRecord] | None) -> dict[int, Truth]:
        found: dict[int, Truth] = {}
        for one in records or []:
            if one.label not in (UNSURE, None):
                patches = found.setdefault(one.frame, UNKNOWN.copy())
                patches[one.row * GRID.cols + one.col] = self.taxonomy.is_obstacle(str(one.label))
        return dict(sorted(found.items()))

    @cached_property
    def obstacle_patches(self) -> dict[int, int]:
        """Patches labelled as an obstacle, by frame; only frames with a label that is sure."""
        return {number: int((truth == 1).sum()) for number, truth in self.labelled.items()}

    def truth(self, number: int) -> Truth:
        """Labels of a frame's patches; -1 everywhere without one that is sure."""
        return self.labelled.get(number, UNKNOWN)

    @cached_property
    def truths(self) -> dict[int, Truth]:
        """Labels of the frames of `scored` that have a sure one."""
        return {n: self.labelled[n] for n in self.scored if n in self.labelled}

    @cached_property
    def ocean_frames(self) -> list[int]:
        """Frames of which every patch is labelled, as clear; of left ones where carried."""
        known = self.left_labelled if self.carried_labels else self.labelled
        return [number for number, truth in known.items() if (truth == 0).all()]

    @cached_property
    def ocean(self) -> TrainingImage:
        """The thesis's image of ocean: the one asked for, or an early frame of the mission."""
        if self.request.ocean is not None:
            return self._given(self.request.ocean)
        number, image = self._first(self.ocean_frames or self.frames)
        return TrainingImage(image, f"the mission's frame {number}", number)

    def _given(self, file: Path) -> TrainingImage:
        return TrainingImage(read_image(file), f"the image {file.name}", self.frame_with(file))

    def frame_with(self, file: Path) -> int | None:
        """The left frame that an image file is a copy of."""
        if not self.mission.path.is_dir():
            return None
        data = file.read_bytes()
        return next(
            (n for n in self.frames if self.mission.encoded(n, self.request.camera)[0] == data),
            None,
        )

    @cached_property
    def other(self) -> TrainingImage:
        """The thesis's image of anything else: the one asked for, or a rendered texture."""
        if self.request.other is not None:
            return self._given(self.request.other)
        words = "a rendered texture for the thesis's film still"
        return TrainingImage(rendered_other_image(), words)

    @property
    def two_images(self) -> str:
        """What the thesis's way of training learnt from, for people."""
        return f"learnt from two images: {self.ocean.words}, and {self.other.words}"

    @cached_property
    def scored(self) -> list[int]:
        """The frames that figures are of: all but those that the thesis's models learn from."""
        learnt = {self.ocean.frame, self.other.frame}
        found = [number for number in self.frames if number not in learnt]
        if not found:
            raise ToktError(
                f"mission {self.mission.name} has one frame, and the thesis's models learn from "
                "it; give them another image of open water with --ocean"
            )
        return found

    def spread(self) -> list[int]:
        """At most the request's sample of `scored`, evenly spaced."""
        return evenly_spaced(self.scored, self.request.sample)

    @cached_property
    def thesis(self) -> dict[str, ThesisModel]:
        """The thesis's texture models: lbp_10_5, lbp_24_8, haralick."""
        return {name: thesis_model(name, self.ocean, self.other) for name in DESCRIBE}

    @cached_property
    def calibration(self) -> StereoCalibration | None:
        """The cameras; `calibration_words` says where from, or why there is none."""
        return self._cameras[0]

    def needed_calibration(self) -> StereoCalibration:
        """The cameras. Raises ToktError, with the reason, where there is no calibration."""
        if self.calibration is None:
            raise ToktError(f"needs a calibration of the two cameras: {self.calibration_words}")
        return self.calibration

    @cached_property
    def calibration_words(self) -> str:
        """Where the calibration is from, or why there is none."""
        return self._cameras[1]

    @cached_property
    def _cameras(self) -> tuple[StereoCalibration | None, str]:
        file = self.request.calibration
        inside = self.mission.path / CALIBRATION_FILE
        if file is not None:
            return read_calibration_file(file, self.say), f"the calibration {file.name}"
        if not self.pairs:
            return None, "the mission has no stereo pairs"
        if inside.is_file():
            return read_calibration_file(inside, self.say), f"the mission's own {CALIBRATION_FILE}"
        self.say("no calibration given: calibrating from the mission's own frames")
        try:
            start = plain_start(self.mission, BASELINE_MM, None, None)
            found = self_calibrate(self.mission, start, self.progress)
        except ToktError as error:
            return None, f"none was given, and the frames do not give one: {error}"
        error_px = found.after.median_px
        words = (
            f"calibrated from the mission's own frames ({found.split_words()}; vertical error "
            f"{error_px:.2f} px median on the tested ones; baseline {BASELINE_MM} mm as printed)"
        )
        return found.calibration, words

    def decoded(self, numbers: Sequence[int]) -> Iterator[tuple[int, U8]]:
        """Left frames one after the other; those that cannot be read are left out, and told."""
        for number in numbers:
            try:
                yield number, self.picture(number)
            except FrameError as error:
                self.say(str(error))
