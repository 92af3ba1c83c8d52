"""One open GenICam camera, through harvesters, and the pictures in its buffers.

For a camera's own process only (see `process`).
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import MOSAIC_FORMATS, PIXEL_FORMATS
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import SourceConfig
from tokt.inference.reason import NO_FAULT, Fault, Reason

from .features import GenicamFeatures
from .producers import ListedCamera, Producers, in_one_line

_NS_PER_S = 1_000_000_000
_COLOUR_BYTES = 3
_PART_IS_IMAGE = 1  # GenTL's PART_DATATYPE_2D_IMAGE


class Pixels(NamedTuple):
    """A picture in a buffer, as the camera gave it."""

    height: int
    width: int
    pixel_format: str  # one of `PIXEL_FORMATS`
    data: U8  # without padding; where that has none the buffer's own memory, gone when it is queued


def pixels_of(buffer: Any, format_name: Callable[[int], str]) -> tuple[Pixels | None, Fault]:
    """The picture in a raw buffer of harvesters, of one with several parts the first image.

    None, and why, if it is not all there, or not of a format that tokt reads.

    Not by harvesters' own components: they leave padding in, and raise for a pixel format that they
    do not know without giving the buffer back. `format_name` gives the name of a format's number.
    """
    image, offset = _image(buffer)
    height, width = int(image.height), int(image.width)
    number = read_property(image, "pixel_format", read_property(image, "data_format", 0))
    pixel_format = format_name(number)
    if pixel_format not in PIXEL_FORMATS:
        words = f"which tokt does not read (it reads {', '.join(PIXEL_FORMATS)})"
        return None, Fault(Reason.UNREADABLE, f"the camera sends {pixel_format} pixels, {words}")
    row = width * (1 if pixel_format in MOSAIC_FORMATS else _COLOUR_BYTES)
    padding = int(read_property(image, "padding_x", read_property(image, "x_padding", 0)))
    lines = int(read_property(buffer, "delivered_image_height", height)) or height
    size = height * (row + padding)
    filled = read_property(buffer, "size_filled", offset + size)
    if lines < height:
        return None, _incomplete(f"{lines} of {height} rows came")
    # The last row's padding may be left out.
    if filled < offset + size - padding:
        return None, _incomplete(f"{max(filled - offset, 0)} of {size} bytes came")
    rows = np.ndarray((height, row), np.uint8, buffer.raw_buffer, offset, (row + padding, 1))
    return Pixels(height, width, pixel_format, np.ascontiguousarray(rows).reshape(-1)), NO_FAULT


def _image(buffer: Any) -> tuple[Any, int]:
    """What describes the picture, and where it begins, in bytes."""
    for part in read_property(buffer, "parts", ()):
        if read_property(part, "data_type", 0) == _PART_IS_IMAGE:
            return part, int(read_property(part, "data_offset", 0))
    return buffer, int(read_property(buffer, "image_offset", 0))


def _incomplete(words: str) -> Fault:
    return Fault(Reason.INCOMPLETE, f"incomplete frame: {words}")


def taken_s(buffer: Any, ticks_per_s: float | None) -> float | None:
    """When it was taken, in seconds of the camera's clock.

    By its ticks where the producer gives these only. None where it does not say, or gives ticks of
    unknown length.
    """
    # Nanoseconds are GenTL's; a time stamp of 0 is a camera's way to have none.
    nanoseconds = read_property(buffer, "timestamp_ns", 0)
    if nanoseconds:
        return float(nanoseconds / _NS_PER_S)
    ticks = read_property(buffer, "timestamp", 0)
    return float(ticks / ticks_per_s) if ticks and ticks_per_s else None


def read_property(module: Any, name: str, otherwise: Any) -> Any:
    """A property of a GenTL module; `otherwise` where the module does not have it."""
    from genicam.gentl import ClosedException, GenericException, InvalidHandleException

    try:
        return getattr(module, name)
    except (ClosedException, InvalidHandleException):
        raise
    except (AttributeError, GenericException):
        return otherwise


_BUFFERS = 4
_WAIT_S = 0.2
_WAIT_MS = 100  # of one call within; a process that shall stop notices it no sooner


class FetchedFrame(NamedTuple):
    """One exposure fetched from the producer's buffers, or why there is no picture."""

    frame_id: int
    fetched_s: float  # ``SYSTEM_CLOCK.monotonic()`` when the producer handed it over
    fault: Fault
    pixels: Pixels | None = None  # gone when the next one is asked for
    taken_s: float | None = None  # of the camera's clock


class GenicamCamera:
    """A camera that is set and sends frames, by its ``harvesters.core.ImageAcquirer``.

    One that does not answer any more raises one of `gone`.
    """

    def __init__(
        self, acquirer: Any, features: GenicamFeatures, gone: tuple[type[Exception], ...]
    ) -> None:
        from harvesters.core import Callback
        from harvesters.util.pfnc import dict_by_ints

        camera = self

        class Incomplete(Callback):  # type: ignore[misc]
            """Told by harvesters, which gives such a buffer back by itself."""

            def emit(self, context: object = None) -> None:
                camera._incomplete = True

        acquirer.add_callback(acquirer.Events.INCOMPLETE_BUFFER, Incomplete())
        self._acquirer = acquirer
        self.gone = gone
        self._formats = dict_by_ints
        self._incomplete = False
        self._last_id = 0
        frequency = read_property(acquirer.device, "timestamp_frequency", 0)
        self._ticks_per_s = frequency or features.value("GevTimestampTickFrequency")
        self.period_s = features.period_s()
        self.shared_clock = features.clock_is_shared()

    @contextmanager
    def next(self) -> Iterator[FetchedFrame | None]:
        """Wait a moment for the next exposure; its pixels are there within the context only.

        None where none came; one of `gone` if the producer says that something is wrong.
        """
        buffer = None
        try:
            self._incomplete = False
            buffer = self._acquirer.try_fetch(timeout=_WAIT_S, is_raw=True)
            yield self._taken(buffer) if buffer is not None else self._not_whole()
        finally:
            if buffer is not None:
                self._give_back(buffer)

    def forget_waiting(self) -> None:
        """Give back what was filled while nobody looked: nothing says how old it is."""
        stream = self._acquirer.data_streams[0]
        for _ in range(int(read_property(stream, "num_awaiting_delivery", 0))):
            buffer = self._acquirer.try_fetch(timeout=_WAIT_S, is_raw=True)
            if buffer is not None:
                self._give_back(buffer)

    def _taken(self, buffer: Any) -> FetchedFrame:
        fetched_s = SYSTEM_CLOCK.monotonic()
        self._last_id = int(read_property(buffer, "frame_id", self._last_id + 1))
        when = taken_s(buffer, self._ticks_per_s)
        pixels, fault = pixels_of(buffer, lambda n: self._formats.get(n, f"unknown (0x{n:08x})"))
        return FetchedFrame(self._last_id, fetched_s, fault, pixels, when)

    def _not_whole(self) -> FetchedFrame | None:
        """What came, where no buffer did."""
        if not self._incomplete:
            return None
        # Its own number went with the buffer; cameras count frames one by one.
        self._last_id += 1
        fault = _incomplete("packets were lost")
        return FetchedFrame(self._last_id, SYSTEM_CLOCK.monotonic(), fault)

    def _give_back(self, buffer: Any) -> None:
        with suppress(*self.gone):  # takes nothing back: the next call says so
            buffer.parent.queue_buffer(buffer)


@contextmanager
def opened_camera(
    producers: Producers, listed: ListedCamera, name: str, options: SourceConfig, share: float
) -> Iterator[GenicamCamera]:
    """Open a camera, set it and have it send frames; ToktError if that cannot be as asked.

    `name` is how the user calls it, and `share` its part of the bandwidth.
    """
    from genicam.genapi import GenericException as FeatureError
    from genicam.gentl import GenericException as ProducerError
    from harvesters.core import ParameterKey, ParameterSet

    gone = (ProducerError, FeatureError)
    values = {
        ParameterKey.NUM_BUFFERS_FOR_FETCH_CALL: _BUFFERS,
        ParameterKey.TIMEOUT_PERIOD_ON_CLIENT_FETCH_CALL: 2 * _WAIT_S,
        ParameterKey.TIMEOUT_PERIOD_ON_UPDATE_EVENT_DATA_CALL: _WAIT_MS,
        ParameterKey.ENABLE_AUTO_CHUNK_DATA_UPDATE: False,
    }
    try:
        harvester, at = producers.harvester, producers.listing.cameras.index(listed)
        info = harvester.device_info_list[at]
        acquirer = harvester.create(info, config=ParameterSet(values))
        features = GenicamFeatures(acquirer.remote_device.node_map, name)
        features.set_up(options, share, listed.link)
        stream = GenicamFeatures(acquirer.data_streams[0].node_map, name)
        stream.give("StreamBufferHandlingMode", "NewestOnly")
        acquirer.start()
        camera = GenicamCamera(acquirer, features, gone)
    except gone as error:
        raise ToktError(f"camera {name} cannot be opened: {in_one_line(str(error))}") from None
    try:
        yield camera
    finally:
        # One that is gone refuses to be closed as it should.
        with suppress(*gone):
            acquirer.destroy()
