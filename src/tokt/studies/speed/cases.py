"""The cases that are timed in this process: kernels on gray patches, and whole frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from skimage.feature import local_binary_pattern

from tokt.features.kernels.dispatch import KERNELS, Kernels
from tokt.inference.policy.policy import judge_image
from tokt.studies.baselines.library_texture import judge_at_once
from tokt.studies.baselines.thesis_texture import (
    GRID,
    describe_haralick,
    haralick_directions,
    judge,
    lbp_counts,
)

from .frames import Picture
from .haralick_agreement import HaralickAgreement
from .models import ModelPair, ThesisFeatureSet
from .paired_timing import BASELINE, FLOOR, LIBRARIES, MEMORY, OURS, Result, in_turns, result

KERNEL_WORK = f"the {GRID.n_patches} patches of one gray picture"
FRAME_WORK = "one decoded frame to its verdict"
TIE = 1e-9
"""A decision value this near to the threshold could fall to either side by rounding alone."""

Item = TypeVar("Item")


class Case(ABC, Generic[Item]):
    """Two ways of doing the same to a picture, or whatever else `Item` is.

    Parameters
    ----------
    name : str
    """

    def __init__(self, name: str) -> None:
        self.name = name

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
    @abstractmethod
    def exact(self) -> bool:
        """Whether every check so far was passed, and there was one."""

    @abstractmethod
    def findings(self) -> dict[str, Any]:
        """Findings of the checks, as JSON values."""

    def timed(self) -> dict[str, Callable[[Item], object]]:
        """The calls that are timed in turns."""
        return {BASELINE: self.baseline, OURS: self.ours}

    def measure(self, items: Sequence[Item], rounds: int) -> Result:
        """Time both ways on some items."""
        times = in_turns(self.timed(), items, rounds)
        return result(self.name, times, self.exact, self.findings())


class LbpKernel(Case[Picture]):
    """Histograms of local binary patterns, border rule ``patch``.

    Parameters
    ----------
    points, radius : int
    kernels : Kernels
    """

    def __init__(self, name: str, points: int, radius: int, kernels: Kernels = KERNELS) -> None:
        super().__init__(name)
        self.points, self.radius = points, radius
        self._kernels = kernels
        self._checked = self._wrong = 0

    def baseline(self, picture: Picture) -> object:
        """One call of scikit-image a patch; the quickest of numpy's ways to count."""
        return [
            np.bincount(
                local_binary_pattern(patch, self.points, self.radius, method="uniform")
                .ravel()
                .astype(np.intp),
                minlength=self.points + 2,
            )
            for patch in picture.patches
        ]

    def ours(self, picture: Picture) -> object:
        """One call."""
        return self._counts(picture)

    def _counts(self, picture: Picture) -> NDArray[np.int64]:
        return self._kernels.lbp_counts(picture.gray, GRID, self.points, self.radius, "patch")

    def check(self, picture: Picture) -> bool:
        """Every count of every patch."""
        theirs = [lbp_counts(patch, self.points, self.radius) for patch in picture.patches]
        self._checked += len(theirs)
        self._wrong += int((self._counts(picture) != np.stack(theirs)).any(axis=1).sum())
        return True

    @property
    def exact(self) -> bool:
        """Whether all counts were the same integers."""
        return self._checked > 0 and self._wrong == 0

    def findings(self) -> dict[str, Any]:
        """Patches looked at, and those with another count."""
        return {
            "of": KERNEL_WORK,
            "patches_checked": self._checked,
            "patches_different": self._wrong,
        }


class HaralickKernel(Case[Picture]):
    """Haralick's features, mean over 4 directions, grey level 0 left out as in the thesis.

    Parameters
    ----------
    kernels : Kernels
    """

    def __init__(self, name: str, kernels: Kernels = KERNELS) -> None:
        super().__init__(name)
        self._kernels = kernels
        self._agreement = HaralickAgreement()
        self._checked = 0

    def baseline(self, picture: Picture) -> object:
        """One call of mahotas a patch."""
        return [describe_haralick(patch) for patch in picture.patches]

    def ours(self, picture: Picture) -> object:
        """One call."""
        return self._kernels.haralick_features(picture.gray, GRID, True)

    def check(self, picture: Picture) -> bool:
        """Every feature of every patch, with and without grey level 0."""
        for ignore_zeros in (True, False):
            rows = self._kernels.haralick_features(picture.gray, GRID, ignore_zeros)
            for row, patch in zip(rows, picture.patches, strict=True):
                self._agreement.add(row, haralick_directions(patch, ignore_zeros))
        self._checked += len(picture.patches)
        return True

    @property
    def exact(self) -> bool:
        """Whether all features agreed as `haralick_agreement.COMPARED` says."""
        return self._checked > 0 and self._agreement.agree

    def findings(self) -> dict[str, Any]:
        """How near the features were."""
        return {
            "of": KERNEL_WORK,
            "patches_checked": self._checked,
            **self._agreement.to_json(),
        }


class WholeFrame(Case[Picture]):
    """A decoded frame to its verdict, through the runtime's own policy ``texture``.

    Parameters
    ----------
    texture : ThesisFeatureSet
    models : ModelPair
    """

    def __init__(self, texture: ThesisFeatureSet, models: ModelPair) -> None:
        super().__init__(f"{texture.name}.frame")
        self._texture, self._models = texture, models
        self._found = dict.fromkeys(
            (
                "frames_checked",
                "frames_different",
                "frames_refused",
                "patches_different",
                "obstacle_patches",
                "obstacle_frames",
                "ties",
            ),
            0,
        )

    def baseline(self, picture: Picture) -> object:
        """Resize, a library call and a predict call a patch, contours."""
        return judge(picture.frame, self._texture.describe_patch, self._models.classifier)

    def ours(self, picture: Picture) -> object:
        """All that ``tokt run`` does between a frame's delivery and its datagram."""
        return judge_image(self._models.bundle, picture.frame)

    def libraries(self, picture: Picture) -> object:
        """The same with all patches counted and predicted at once."""
        texture, models = self._texture, self._models
        return judge_at_once(picture.frame, texture.describe_all, models.classifier)

    def floor(self, picture: Picture) -> object:
        """The least that judging patches takes: making the small gray picture."""
        height, width = GRID.resized(*picture.frame.shape[:2])
        return KERNELS.resized_gray(picture.frame, height, width)

    def memory(self, picture: Picture) -> object:
        """The least that reading the frame takes: each byte once."""
        return picture.frame.max()

    def check(self, picture: Picture) -> bool:
        """Labels of all patches, status, centre and box, unless the runtime refuses the frame."""
        found, model = self._found, self._models.bundle.model
        judgement = judge_image(self._models.bundle, picture.frame)
        if judgement.decision_values is None:
            # The runtime refuses, say, a black frame; the thesis's way has no such word.
            found["frames_refused"] += 1
            return False
        theirs = judge(picture.frame, self._texture.describe_patch, self._models.classifier)
        labels = model.obstacle_patches(judgement.decision_values)
        ours, verdict = judgement.verdict, theirs.verdict
        same = (ours.status, ours.x, ours.y, ours.box) == (
            *(verdict.status, verdict.x, verdict.y, verdict.box),
        )
        different = int((labels != theirs.obstacle).sum())
        found["frames_checked"] += 1
        found["frames_different"] += not same or different > 0
        found["patches_different"] += different
        found["obstacle_patches"] += int(theirs.obstacle.sum())
        found["obstacle_frames"] += bool(theirs.obstacle.any())
        found["ties"] += int((np.abs(judgement.decision_values - model.thresholds) < TIE).sum())
        return True

    @property
    def exact(self) -> bool:
        """Whether all frames that were judged had the same labels and verdict."""
        return self._found["frames_checked"] > 0 and self._found["frames_different"] == 0

    def findings(self) -> dict[str, Any]:
        """What was compared."""
        return {
            "of": FRAME_WORK,
            "baseline_is": "the thesis's way: a library call and a predict call a patch",
            "libraries_is": "the libraries with all patches counted and predicted at once",
            "floor_is": "resize and gray alone, with tokt's kernels",
            "memory_is": "reading each byte of the frame once",
            **self._found,
        }

    def timed(self) -> dict[str, Callable[[Picture], object]]:
        """Both ways, the libraries used well, and the floors."""
        more = {LIBRARIES: self.libraries, FLOOR: self.floor, MEMORY: self.memory}
        return {**super().timed(), **more}
