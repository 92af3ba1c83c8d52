"""The pictures and cases that are timed in this process: kernels on patches, whole frames."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
from skimage.feature import local_binary_pattern

from tokt.features.common.arrays import I64, U8
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.extractors.spec import build_extractor
from tokt.features.kernels.dispatch import KERNELS, LIBRARY, Kernels, load_kernels
from tokt.features.kernels.quantization import Quantization
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import assemble
from tokt.inference.policy.moving import STEP_S
from tokt.inference.policy.policy import judge_image
from tokt.inference.verdict import CLEAR, UNKNOWN
from tokt.models.bundle.bundle import Bundle
from tokt_studies.baselines import thesis_texture

from .haralick_agreement import HaralickAgreement
from .models import ModelPair, ThesisFeatureSet, judge_at_once
from .paired_timing import BASELINE, FLOOR, LIBRARIES, MEMORY, OURS, Result, in_turns, result

KERNEL_WORK = f"the {thesis_texture.GRID.n_patches} patches of one gray picture"
FRAME_WORK = "one decoded frame to its verdict"
TIE = 1e-9
"""A decision value this near to the threshold could fall to either side by rounding alone."""
MAX_TIMES = 2.5
"""How many times the plain extractor's time the preset best may take."""
_HEIGHT, _WIDTH, _CELL = 1024, 1360, 4  # pixels of the textured frame

Item = TypeVar("Item")


@dataclass(frozen=True)
class Picture:
    """One frame as each case wants it."""

    frame: U8  # (height, width) or (height, width, 3), as decoded

    @cached_property
    def gray(self) -> U8:
        """At the grid's width, gray."""
        return thesis_texture.resized_gray(self.frame)

    @cached_property
    def patches(self) -> list[U8]:
        """The gray patches, each contiguous in memory."""
        return [np.ascontiguousarray(patch) for patch in thesis_texture.GRID.cells(self.gray)]


def textured_frame() -> U8:
    """A colour frame of 1360x1024 full of contrast: cells of random grey levels, 0 to 255.

    Its patches hold nearly all grey levels and hardly a pair of them twice, where frames of open
    sea hold a dozen: the most there is to count. A cell is four pixels wide, so that it is still
    there after the resize.
    """
    cells = np.random.default_rng(1).integers(0, 256, (_HEIGHT // _CELL, _WIDTH // _CELL), np.uint8)
    gray = cells.repeat(_CELL, axis=0).repeat(_CELL, axis=1)
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)


class Case(ABC, Generic[Item]):
    """Two ways of doing the same to a picture, or whatever else `Item` is."""

    about: Mapping[str, Any] = {"of": FRAME_WORK}  # what the findings begin with
    what, fault = "frames", "different"  # that are checked, and how they may be found

    def __init__(self, name: str) -> None:
        self.name = name
        # Of what was compared so far, and what of it was not the same.
        self.checked = self.wrong = 0

    @abstractmethod
    def baseline(self, item: Item) -> object:
        """The libraries' way, or the thesis's."""

    @abstractmethod
    def ours(self, item: Item) -> object:
        """Tokt's way."""

    @abstractmethod
    def check(self, item: Item) -> bool:
        """Do both, not timed, and remember whether they gave the same; whether they could."""

    @property
    def exact(self) -> bool:
        """Whether every check so far was passed, and there was one."""
        return self.checked > 0 and self.wrong == 0

    def findings(self) -> dict[str, Any]:
        """Findings of the checks, as JSON values."""
        counts = {f"{self.what}_checked": self.checked, f"{self.what}_{self.fault}": self.wrong}
        return {**self.about, **counts}

    def timed(self) -> dict[str, Callable[[Item], object]]:
        """The calls that are timed in turns: each of these methods that the case has."""
        ways = (BASELINE, OURS, LIBRARIES, FLOOR, MEMORY)
        return {way: getattr(self, way) for way in ways if hasattr(self, way)}

    def measure(self, items: Sequence[Item], rounds: int) -> Result:
        """Time both ways on some items."""
        times = in_turns(self.timed(), items, rounds)
        return result(self.name, times, self.exact, self.findings())


class LbpKernel(Case[Picture]):
    """Histograms of local binary patterns, border rule ``patch``."""

    about: Mapping[str, Any] = {"of": KERNEL_WORK}
    what = "patches"

    def __init__(self, name: str, points: int, radius: int, kernels: Kernels = KERNELS) -> None:
        super().__init__(name)
        self.points, self.radius = points, radius
        self._kernels = kernels

    def baseline(self, picture: Picture) -> object:
        """One call of scikit-image a patch; the quickest of numpy's ways to count."""
        counts = []
        for patch in picture.patches:
            codes = local_binary_pattern(patch, self.points, self.radius, method="uniform")
            counts.append(np.bincount(codes.ravel().astype(np.intp), minlength=self.points + 2))
        return counts

    def ours(self, picture: Picture) -> I64:
        """One call."""
        return self._kernels.lbp_counts(
            picture.gray, thesis_texture.GRID, self.points, self.radius, "patch"
        )

    def check(self, picture: Picture) -> bool:
        """Every count of every patch."""
        theirs = [
            thesis_texture.lbp_counts(patch, self.points, self.radius) for patch in picture.patches
        ]
        self.checked += len(theirs)
        self.wrong += int((self.ours(picture) != np.stack(theirs)).any(axis=1).sum())
        return True


class HaralickKernel(Case[Picture]):
    """Haralick's features, mean over 4 directions, grey level 0 left out as in the thesis."""

    def __init__(self, name: str, kernels: Kernels = KERNELS) -> None:
        super().__init__(name)
        self._kernels = kernels
        self._agreement = HaralickAgreement()

    def baseline(self, picture: Picture) -> object:
        """One call of mahotas a patch."""
        return [thesis_texture.describe_haralick(patch) for patch in picture.patches]

    def ours(self, picture: Picture) -> object:
        """One call."""
        return self._kernels.haralick_features(picture.gray, thesis_texture.GRID, True)

    def check(self, picture: Picture) -> bool:
        """Every feature of every patch, with and without grey level 0."""
        for ignore_zeros in (True, False):
            rows = self._kernels.haralick_features(picture.gray, thesis_texture.GRID, ignore_zeros)
            for row, patch in zip(rows, picture.patches, strict=True):
                self._agreement.add(row, thesis_texture.haralick_directions(patch, ignore_zeros))
        self.checked += len(picture.patches)
        self.wrong = int(not self._agreement.agree)
        return True

    def findings(self) -> dict[str, Any]:
        """How near the features were."""
        return {"of": KERNEL_WORK, "patches_checked": self.checked, **self._agreement.to_json()}


class WholeFrame(Case[Picture]):
    """A decoded frame to its verdict, through the runtime's own policy ``texture``."""

    about: Mapping[str, Any] = {
        "of": FRAME_WORK,
        "baseline_is": "the thesis's way: a library call and a predict call a patch",
        "libraries_is": "the libraries with all patches counted and predicted at once",
        "floor_is": "resize and gray alone, with tokt's kernels",
        "memory_is": "reading each byte of the frame once",
    }

    def __init__(self, texture: ThesisFeatureSet, models: ModelPair) -> None:
        super().__init__(f"{texture.name}.frame")
        self._texture, self._models = texture, models
        keys = "frames_refused", "patches_different", "obstacle_patches", "obstacle_frames"
        self._found = dict.fromkeys((*keys, "ties"), 0)

    def baseline(self, picture: Picture) -> object:
        """Resize, a library call and a predict call a patch, contours."""
        return thesis_texture.judge(
            picture.frame, self._texture.describe_patch, self._models.classifier
        )

    def ours(self, picture: Picture) -> object:
        """All that ``tokt run`` does between a frame's delivery and its datagram."""
        return judge_image(self._models.bundle, picture.frame)

    def libraries(self, picture: Picture) -> object:
        """The same with all patches counted and predicted at once."""
        texture, models = self._texture, self._models
        return judge_at_once(picture.frame, texture.describe_all, models.classifier)

    def floor(self, picture: Picture) -> object:
        """The least that judging patches takes: making the small gray picture."""
        height, width = thesis_texture.GRID.resized(*picture.frame.shape[:2])
        return KERNELS.resized_gray(picture.frame, height, width)

    def memory(self, picture: Picture) -> object:
        """The least that reading the frame takes: each byte once."""
        return picture.frame.max()

    def check(self, picture: Picture) -> bool:
        """Labels of all patches, status, centre and box, unless the runtime refuses the frame."""
        found, model = self._found, self._models.bundle.model
        judgement = judge_image(self._models.bundle, picture.frame)
        # The runtime refuses, say, a black frame; the thesis's way has no such word.
        refused = judgement.verdict.status == UNKNOWN
        found["frames_refused"] += refused
        if judgement.decision_values is None:
            return False
        theirs = thesis_texture.judge(
            picture.frame, self._texture.describe_patch, self._models.classifier
        )
        labels = model.obstacle_patches(judgement.decision_values)
        said = attrgetter("status", "x", "y", "box")
        same = said(judgement.verdict) == said(theirs.verdict)
        # Of those that it looked at it refuses to call clear what it cannot see.
        same |= refused and theirs.verdict.status == CLEAR
        different = int((labels != theirs.obstacle).sum())
        self.checked += 1
        self.wrong += not same or different > 0
        found["patches_different"] += different
        found["obstacle_patches"] += int(theirs.obstacle.sum())
        found["obstacle_frames"] += bool(theirs.obstacle.any())
        found["ties"] += int((np.abs(judgement.decision_values - model.thresholds) < TIE).sum())
        return True

    def findings(self) -> dict[str, Any]:
        """What was compared."""
        return {**super().findings(), **self._found}


class PresetFrame(Case[Picture]):
    """A decoded frame to its verdict, by a plain extractor's model and by that of a preset."""

    what = "pictures"

    def __init__(self, preset: str, plain: Bundle, bundle: Bundle) -> None:
        super().__init__(f"{preset}.frame")
        self._plain, self._bundle = plain, bundle
        self.about = {
            "of": FRAME_WORK,
            "baseline_is": f"tokt itself with the plain model {plain.label}",
            "floor_is": "the pictures that the preset's extractor looks at, prepared and no more",
            "asked": f"preset best's time is at most {MAX_TIMES:g} times the plain one's",
            "features": bundle.extractor.dim,
        }
        self._images = build_extractor(bundle.extractor.spec).images
        self._reference = load_kernels(LIBRARY)

    def baseline(self, picture: Picture) -> object:
        """The plain extractor's model."""
        return judge_image(self._plain, picture.frame)

    def ours(self, picture: Picture) -> object:
        """The preset's."""
        return judge_image(self._bundle, picture.frame)

    def floor(self, picture: Picture) -> list[U8]:
        """The pictures that the preset looks at, prepared and no more."""
        prepared = FramePictures(picture.frame, thesis_texture.GRID)
        return [prepared.picture(image) for image in self._images]

    def _expected(self, picture: Picture, image: Quantization | None) -> U8:
        if image is None:
            return picture.gray
        size = thesis_texture.GRID.resized(*picture.frame.shape[:2])
        return self._reference.quantize(self._reference.resized_gray16(picture.frame, *size), image)

    def check(self, picture: Picture) -> bool:
        """Every pixel of these pictures, against matrix products; their textures have own cases."""
        for image, found in zip(self._images, self.floor(picture), strict=True):
            self.checked += 1
            self.wrong += not np.array_equal(found, self._expected(picture, image))
        return True


class MovingFrame(Case[Picture]):
    """A decoded frame to its verdict, without a look for what moves by itself, and with one."""

    about: Mapping[str, Any] = {
        "of": FRAME_WORK,
        "baseline_is": "tokt itself without --moving: texture alone",
        "asked": "ours takes at most 4 ms more",
    }
    fault = "made_clear"

    def __init__(self, bundle: Bundle) -> None:
        super().__init__("moving.frame")
        self._alone = assemble("texture", lambda: bundle, None, moving=None).policy
        self._moving = assemble("texture", lambda: bundle, None).policy
        self._frames = 0

    def _next(self, picture: Picture) -> Frame:
        """The picture as the next frame; points are followed in each."""
        self._frames += 1
        t_s = 2 * STEP_S * self._frames
        return Frame(self._frames, t_s, picture.frame, None, timed=True)

    def baseline(self, picture: Picture) -> object:
        """Texture alone."""
        return self._alone.judge(self._next(picture))

    def ours(self, picture: Picture) -> object:
        """Points followed from the frame before, and the watch for sediment, as well."""
        return self._moving.judge(self._next(picture))

    def check(self, picture: Picture) -> bool:
        """It makes no frame clear."""
        policies = self._alone, self._moving
        alone, ours = (each.judge(self._next(picture)).verdict.status for each in policies)
        self.checked += 1
        self.wrong += ours == CLEAR != alone
        return True
