"""Folders of frames and video files as a source."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.camera_frame import MOSAIC_FORMATS, frame_from_camera
from tokt.features.frames.mission import LEFT, RIGHT, Mission, chosen_frames, open_mission
from tokt.inference.clock import SYSTEM_CLOCK, Clock
from tokt.inference.frame import Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.models.operating_point import missed_before

_STOP_CHECK_S = 0.05
_NOT_READ = Fault(Reason.MISSING, "not read")


@dataclass(eq=False)
class MissionSource:
    """Replay a mission from disk: a stereo folder, a flat folder or a video.

    Delivered are `frames`, by default every number that one of the cameras has, so that a frame
    missing on the left is one that cannot be judged, and not one that never was. With a rate, in
    frames per second, a frame is due at a fixed time after the first, so a late one delays none
    after it; without one each frame comes as soon as it is asked for. With `stereo` the right
    camera's frames are read as well. With `pixel_format`, one of `MOSAIC_FORMATS`, the images are
    gray and hold a camera's raw pixels in it.

    Raises ToktError if the rate is not positive, a chosen frame is not in the mission, or the pixel
    format is not one of those.
    """

    mission: Mission
    clock: Clock
    frames: Sequence[int] | None = None
    rate: float | None = None
    stereo: bool = True
    pixel_format: str | None = None

    def __post_init__(self) -> None:
        if self.pixel_format is not None and self.pixel_format not in MOSAIC_FORMATS:
            words = f"{self.pixel_format!r} pixels (choose from {', '.join(MOSAIC_FORMATS)})"
            raise ToktError(f"image files hold no {words}")
        if self.rate is not None and not 0 < self.rate < float("inf"):
            raise ToktError(f"a rate is a positive number of frames per second, not {self.rate}")
        cameras = self.mission.cameras
        both = [set(self.mission.frames(camera)) for camera in cameras]
        if self.stereo and len(both) > 1 and not set.intersection(*both):
            raise ToktError(
                f"mission {self.mission.path} has no pairs: a left and a right picture are one "
                "where their names are the same. Rename them, or give the folder Left alone"
            )
        self.numbers = chosen_frames(self.mission, self.frames, *cameras)
        places = [self.mission.place(number) for number in self.numbers]
        self._missed = missed_before(places, 1)
        self._stopped = False

    def __iter__(self) -> Iterator[Frame]:
        """Deliver the frames."""
        start = self.clock.monotonic()
        for index, number in enumerate(self.numbers):
            left, left_fault = self._read(number, LEFT)
            right, right_fault = self._read(number, RIGHT) if self.stereo else (None, _NOT_READ)
            due = start if self.rate is None else start + index / self.rate
            # In short pieces, so that `stop` is noticed.
            while not self._stopped and (left_s := due - self.clock.monotonic()) > 0:
                self.clock.sleep(min(left_s, _STOP_CHECK_S))
            if self._stopped:
                return
            now = self.clock.time()
            views, missed = (left, right, left_fault, right_fault), self._missed[index]
            timed, arrived = self.rate is not None, self.clock.monotonic()
            yield Frame(
                *(number, now, *views, missed),
                timed=timed,
                arrived=arrived,
                masks=self.mission.masks,
                file=self.mission.file_name(number),
            )

    @property
    def live(self) -> bool:
        """Whether there is a rate."""
        return self.rate is not None

    def stop(self) -> None:
        """Deliver no further frame."""
        self._stopped = True

    def _read(self, number: int, camera: str) -> tuple[U8 | None, Fault]:
        return read_picture(self.mission, number, camera, self.pixel_format)


def read_picture(
    mission: Mission, number: int, camera: str, pixel_format: str | None = None
) -> tuple[U8 | None, Fault]:
    """One camera's picture of a mission's frame, or why there is none.

    `camera` is `LEFT` or `RIGHT`, `pixel_format` as in `MissionSource`.
    """
    try:
        image = mission.read(number, camera)
    except FrameError as error:
        present = number in mission.frames(camera)
        reason = Reason.UNREADABLE if present else Reason.MISSING
        return None, Fault(reason, str(error))
    if pixel_format is None:
        return image, NO_FAULT
    if image.ndim != 2:
        words = f"the image is in colour: it does not hold raw {pixel_format} pixels"
        return None, Fault(Reason.UNREADABLE, words)
    height, width = image.shape
    try:
        return frame_from_camera(image, height, width, pixel_format), NO_FAULT
    except ValueError as error:
        return None, Fault(Reason.UNREADABLE, str(error))


def open_source(
    text: str | Path,
    clock: Clock = SYSTEM_CLOCK,
    frames: Sequence[int] | None = None,
    rate: float | None = None,
    stereo: bool = True,
    pixel_format: str | None = None,
) -> MissionSource:
    """Open the folder or the video file that a user named, the rest as in `MissionSource`.

    ToktError if it is neither, or `MissionSource` refuses the rest.

    Examples
    --------
    >>> for frame in tokt.open_source("dive"):  # doctest: +SKIP
    ...     verdict = policy.judge(frame).verdict
    """
    if not Path(text).exists():
        raise ToktError(
            f"unknown source {str(text)!r}: not a folder of frames and not a video file"
        )
    return MissionSource(open_mission(text), clock, frames, rate, stereo, pixel_format)
