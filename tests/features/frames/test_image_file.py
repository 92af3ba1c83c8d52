import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.tiers import scaled
from tokt.features.common.errors import FrameError
from tokt.features.frames.image_file import _jpeg_is_whole, decode_image, pixel_sha256, read_image

Image = NDArray[np.uint8]

WAYS = {
    "baseline": (".jpg", []),
    "progressive": (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    "restarts": (".jpg", [cv2.IMWRITE_JPEG_RST_INTERVAL, 3]),
    "both": (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 5]),
    "best-quality": (".jpg", [cv2.IMWRITE_JPEG_QUALITY, 100]),
    "png": (".png", []),
}


def encode(image: Image, suffix: str, options: list[int] | None = None) -> bytes:
    good, data = cv2.imencode(suffix, image, options or [])
    assert good
    return bytes(data.tobytes())


@pytest.fixture(scope="session", params=[f"{way} {kind}" for way in WAYS for kind in "gc"])
def picture(request, colour, gray):
    """An encoded picture and what OpenCV makes of the whole of it."""
    way, kind = request.param.split()
    suffix, options = WAYS[way]
    data = encode(gray if kind == "g" else colour, suffix, options)
    return data, np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR))


def test_the_ways_of_writing_differ(colour):
    files = {name: encode(colour, *way) for name, way in WAYS.items()}
    assert len(set(files.values())) == len(WAYS)
    assert b"\xff\xc2" in files["progressive"] and b"\xff\xd3" in files["restarts"]


def test_whole_pictures(picture):
    data, image = picture
    assert np.array_equal(decode_image(data, "a"), image)
    for tail in (b"\x00", b"\xff", b"\xff\xd9", b"camera trailer" * 20):
        assert np.array_equal(decode_image(data + tail, "a"), image)


def test_prefixes_are_refused(picture):
    data, _ = picture
    ends = {*range(40), *range(0, len(data), max(1, len(data) // 250))}
    ends |= set(range(len(data) - 40, len(data)))
    for end in sorted(ends):
        # Seen by tokt itself; what a decoder makes of it depends on its version.
        with pytest.raises(FrameError, match="truncated" if end >= 8 else "cut"):
            decode_image(data[:end], "cut")


@settings(max_examples=scaled(60))
@given(fraction=st.floats(0, 1, exclude_max=True))
def test_any_prefix_is_refused(picture, fraction):
    data, _ = picture
    with pytest.raises(FrameError):
        decode_image(data[: int(fraction * len(data))], "cut")


@pytest.mark.parametrize("suffix", [".bmp", ".tif", ".ppm"])
def test_prefixes_of_other_formats_are_refused(colour, suffix):
    data = encode(colour, suffix)
    assert np.array_equal(decode_image(data, "a"), colour)
    for end in {*range(64), *range(64, len(data), len(data) // 60), len(data) - 1}:
        with pytest.raises(FrameError):
            decode_image(data[:end], "cut")


@pytest.mark.parametrize("way", [way for way in WAYS if way != "png"])
def test_thumbnail_is_not_the_end(colour, way):
    whole = encode(colour, *WAYS[way])
    # In its APP1 segment, as cameras write them.
    payload = b"Exif\x00\x00" + encode(colour[::5, ::5].copy(), ".jpg")
    segment = b"\xff\xe1" + (len(payload) + 2).to_bytes(2, "big") + payload
    data = whole[:2] + segment + whole[2:]
    assert np.array_equal(decode_image(data, "a"), decode_image(whole, "b"))
    end_of_thumbnail = data.index(b"\xff\xd9") + 2
    assert end_of_thumbnail < len(data) - len(whole) + 10
    ends = [*range(end_of_thumbnail - 3, end_of_thumbnail + 12), len(data) - 1]
    for end in ends + list(range(end_of_thumbnail, len(data), len(whole) // 50)):
        with pytest.raises(FrameError, match="truncated"):
            decode_image(data[:end], "cut")


def test_a_segment_that_points_past_the_end_is_refused(colour):
    data = bytearray(encode(colour, ".jpg"))
    data[4:6] = b"\xff\xff"
    with pytest.raises(FrameError):
        decode_image(bytes(data), "a")


def test_fill_bytes_before_a_marker(colour):
    data = encode(colour, ".jpg")
    filled = data[:2] + b"\xff\xff\xff" + data[2:-2] + b"\xff\xff" + data[-2:]
    assert np.array_equal(decode_image(filled, "a"), decode_image(data, "b"))
    with pytest.raises(FrameError):
        decode_image(filled[:-1], "cut")


def only_a_frame_error(data: bytes) -> None:
    try:
        image = decode_image(data, "junk")
    except FrameError as error:
        assert str(error).startswith("junk: ")
    else:
        assert image.dtype == np.uint8
        assert image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)


edits = st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255), st.booleans())
heads = st.sampled_from([b"", b"\xff\xd8", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"BM", b"P5\n"])


@settings(max_examples=scaled(200))
@given(head=heads, data=st.binary(max_size=300))
def test_junk(head, data):
    only_a_frame_error(head + data)


@settings(max_examples=scaled(40), suppress_health_check=[HealthCheck.too_slow])
@given(edits=st.lists(edits, min_size=1, max_size=4))
def test_damaged_pictures(picture, edits):
    """Up to four bytes replaced, in the headers or anywhere."""
    data = bytearray(picture[0])
    for where, value, anywhere in edits:
        data[int(where * (len(data) if anywhere else 64))] = value
    only_a_frame_error(bytes(data))


@pytest.mark.parametrize("length", [0, 1, 2, 3, 0x7FFF, 0xFFFF])
def test_segment_lengths(colour, length):
    data = bytearray(encode(colour, ".jpg"))
    position = 2
    while data[position + 1] != 0xDA:
        tricked = bytearray(data)
        tricked[position + 2 : position + 4] = length.to_bytes(2, "big")
        only_a_frame_error(bytes(tricked))
        only_a_frame_error(bytes(tricked[: position + 4]))
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")


@pytest.mark.parametrize("length", [0, 1, 0x7FFFFFFF, 0xFFFFFFFF])
def test_chunk_lengths(colour, length):
    data = bytearray(encode(colour, ".png"))
    position = data.index(b"IDAT") - 4
    data[position : position + 4] = length.to_bytes(4, "big")
    only_a_frame_error(bytes(data))


def test_empty_missing_and_folder(tmp_path):
    with pytest.raises(FrameError, match="empty"):
        decode_image(b"", "a")
    with pytest.raises(FrameError, match="No such file"):
        read_image(tmp_path / "none.jpg")
    with pytest.raises(FrameError):
        read_image(tmp_path)


def test_pixel_hash_is_of_pixels(tmp_path, gray):
    for suffix in (".png", ".bmp"):
        cv2.imwrite(str(tmp_path / f"a{suffix}"), gray)
    a, b = read_image(tmp_path / "a.png"), read_image(tmp_path / "a.bmp")
    assert pixel_sha256(a) == pixel_sha256(gray)
    assert pixel_sha256(np.atleast_3d(b)[:, :, 0]) == pixel_sha256(gray)
    assert pixel_sha256(gray) != pixel_sha256(gray.T)
    assert pixel_sha256(gray.reshape(60, -1)) != pixel_sha256(gray)
    assert pixel_sha256(gray[:, ::2]) == pixel_sha256(gray[:, ::2].copy())


@pytest.mark.mission
def test_every_real_frame_is_accepted(mission):
    files = sorted(mission.glob("*/*.jpg"))
    assert len(files) == 492
    for index, file in enumerate(files):
        data = file.read_bytes()
        assert _jpeg_is_whole(data), file
        if index % 40 == 0:
            assert decode_image(data, file.name).shape[:2] == (1024, 1360)
            for end in range(1000, len(data) - 1, len(data) // 5):
                with pytest.raises(FrameError):
                    decode_image(data[:end], file.name)


def test_a_png_that_says_it_is_huge_is_not_decoded(gray):
    png = bytearray(cv2.imencode(".png", gray)[1].tobytes())
    png[16:24] = (20_000).to_bytes(4, "big") * 2
    with pytest.raises(FrameError, match="400000000 pixels"):
        decode_image(bytes(png), "p.png")
