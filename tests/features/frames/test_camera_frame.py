import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.features.frames.camera_frame import MOSAIC_FORMATS, PIXEL_FORMATS, frame_from_camera

BAYER = tuple(name for name in PIXEL_FORMATS if name.startswith("Bayer"))
BLUE, GREEN, RED = 0, 1, 2
# The first two rows' first two pixels, as GenICam names them: row one is in the name, row two
# completes the square of two greens, a red and a blue.
SQUARES = {
    "BayerRG8": ((RED, GREEN), (GREEN, BLUE)),
    "BayerGR8": ((GREEN, RED), (BLUE, GREEN)),
    "BayerGB8": ((GREEN, BLUE), (RED, GREEN)),
    "BayerBG8": ((BLUE, GREEN), (GREEN, RED)),
}
sizes = st.integers(3, 33)


def smooth(height: int, width: int) -> np.ndarray:
    """A BGR picture whose colours rise evenly, each in its own direction and range."""
    y, x = np.mgrid[:height, :width]
    return np.stack([200 + 0 * x, 40 + x, 90 + 2 * y], axis=2).astype(np.uint8)


def mosaic(colours: np.ndarray, pixel_format: str) -> np.ndarray:
    """What a sensor with that pattern of filters records."""
    raw = np.zeros(colours.shape[:2], np.uint8)
    for dy, row in enumerate(SQUARES[pixel_format]):
        for dx, channel in enumerate(row):
            raw[dy::2, dx::2] = colours[dy::2, dx::2, channel]
    return raw


def raw_size(pixel_format: str, height: int, width: int) -> int:
    return height * width * (1 if pixel_format in MOSAIC_FORMATS else 3)


def raw_data(pixel_format: str, height: int, width: int) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.integers(0, 256, raw_size(pixel_format, height, width), np.uint8)


@pytest.mark.parametrize("pixel_format", BAYER)
@given(height=sizes, width=sizes)
def test_a_mosaic_gives_its_colours_back(pixel_format, height, width):
    colours = smooth(height, width)
    frame = frame_from_camera(mosaic(colours, pixel_format), height, width, pixel_format)
    # Bilinear interpolation is exact on an even rise; OpenCV copies the outermost pixels.
    inside = (slice(1, -1), slice(1, -1))
    assert np.abs(frame[inside].astype(int) - colours[inside]).max() <= 1
    assert np.abs(frame.astype(int) - colours).max() <= 3


@given(height=sizes, width=sizes)
def test_formats_without_a_mosaic_keep_their_pixels(height, width):
    gray = raw_data("Mono8", height, width)
    frame = frame_from_camera(gray.tobytes(), height, width, "Mono8")
    np.testing.assert_array_equal(frame, gray.reshape(height, width))
    colours = raw_data("BGR8", height, width).reshape(height, width, 3)
    for suffix in ("", "Packed"):
        frame = frame_from_camera(colours, height, width, f"BGR8{suffix}")
        np.testing.assert_array_equal(frame, colours)
        frame = frame_from_camera(colours, height, width, f"RGB8{suffix}")
        np.testing.assert_array_equal(frame, colours[:, :, ::-1])


@given(
    pixel_format=st.sampled_from(PIXEL_FORMATS),
    height=sizes,
    width=sizes,
    kind=st.sampled_from([bytes, bytearray, memoryview, np.asarray]),
)
def test_a_frame_never_changes_with_the_driver_s_buffer(pixel_format, height, width, kind):
    buffer = raw_data(pixel_format, height, width)
    expected = frame_from_camera(buffer.copy(), height, width, pixel_format)
    shape = (height, width) if pixel_format == "Mono8" else (height, width, 3)
    frame = frame_from_camera(kind(buffer), height, width, pixel_format)
    assert frame.dtype == np.uint8 and frame.shape == shape and frame.flags.c_contiguous
    assert not np.may_share_memory(frame, buffer)
    buffer[:] = 0
    np.testing.assert_array_equal(frame, expected)


@given(
    pixel_format=st.sampled_from(PIXEL_FORMATS),
    height=sizes,
    width=sizes,
    off=st.integers(-8, 8).filter(bool),
)
def test_data_of_another_size_are_refused(pixel_format, height, width, off):
    right = raw_size(pixel_format, height, width)
    with pytest.raises(ValueError, match=f"{width}x{height} has {right} bytes, not {right + off}"):
        frame_from_camera(bytes(right + off), height, width, pixel_format)


def test_data_need_not_lie_in_one_piece():
    colours = raw_data("BGR8", 6, 9).reshape(6, 9, 3)
    frame = frame_from_camera(colours[:, :, ::-1], 6, 9, "RGB8")
    np.testing.assert_array_equal(frame, colours)


@pytest.mark.parametrize("pixel_format", ["", "Mono12", "bayerrg8", "YUV422"])
def test_unknown_formats_are_refused_with_the_known_ones(pixel_format):
    with pytest.raises(ValueError, match=r"unknown pixel format .* \(known: Mono8, BayerRG8"):
        frame_from_camera(bytes(16), 4, 4, pixel_format)


def test_what_cannot_be_a_frame_is_refused():
    with pytest.raises(ValueError, match="uint8, not uint16"):
        frame_from_camera(np.zeros(16, np.uint16), 4, 4, "Mono8")
    with pytest.raises(ValueError, match="too small"):
        frame_from_camera(bytes(8), 2, 4, "BayerRG8")
    with pytest.raises(ValueError, match="too small"):
        frame_from_camera(b"", 0, 4, "Mono8")
