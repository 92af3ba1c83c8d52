import zlib

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.features.common.errors import FrameError
from tokt.features.frames.image_file import decode_image, is_shown_alike, pixel_sha256, read_image

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
def test_real_frames_are_accepted_and_their_beginnings_are_not(mission):
    files = sorted(mission.glob("*/*.jpg"))
    assert len(files) == 492
    for file in files[::12]:
        data = file.read_bytes()
        assert decode_image(data, file.name).shape[:2] == (1024, 1360)
        for end in range(1000, len(data) - 1, len(data) // 5):
            with pytest.raises(FrameError):
                decode_image(data[:end], file.name)


def test_a_png_that_says_it_is_huge_is_not_decoded(gray):
    png = bytearray(cv2.imencode(".png", gray)[1].tobytes())
    png[16:24] = (20_000).to_bytes(4, "big") * 2
    with pytest.raises(FrameError, match="400000000 pixels"):
        decode_image(bytes(png), "p.png")


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpeg_that_says_it_is_huge_is_not_decoded(gray, progressive):
    jpeg = cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1].tobytes()
    at = jpeg.index(b"\xff\xc2" if progressive else b"\xff\xc0") + 5
    with pytest.raises(FrameError, match="400000000 pixels"):
        decode_image(jpeg[:at] + (20_000).to_bytes(2, "big") * 2 + jpeg[at + 4 :], "p.jpg")


DEEP = [(suffix, shape) for suffix in (".png", ".tif", ".pgm") for shape in ((40, 60), (40, 60, 3))]
DEEP[-1] = (".ppm", (40, 60, 3))


@pytest.mark.parametrize(("suffix", "shape"), DEEP)
@pytest.mark.parametrize("bits", [8, 10, 12])
def test_few_bits_in_16_are_refused_with_the_remedy(suffix, shape, bits):
    """As nearly black pictures they lost what was to be seen, and nobody was told."""
    values = np.random.default_rng(1).integers(0, 2**bits, shape, np.uint16)
    values.flat[0] = 2**bits - 1
    with pytest.raises(FrameError, match=r"^a: its 16-bit pixels .*; convert it to 8 bits"):
        decode_image(encode(values, suffix), "a")


@pytest.mark.parametrize(("suffix", "shape"), DEEP)
@pytest.mark.parametrize("shift", [0, 4], ids=["16 bits", "12 bits at the top"])
def test_16_bits_are_seen_by_their_upper_8(suffix, shape, shift):
    values = np.random.default_rng(1).integers(0, 2**16, shape, np.uint16) >> shift << shift
    # OpenCV rounds colour TIFF, and cuts off the others, as it always did: datasets hold hashes.
    image = decode_image(encode(values, suffix), "a")
    assert image.dtype == np.uint8
    assert np.abs(image - (values >> 8).astype(int)).max() <= (suffix == ".tif" and len(shape) == 3)
    data = np.frombuffer(encode(values, suffix), np.uint8)
    assert np.array_equal(image, cv2.imdecode(data, cv2.IMREAD_ANYCOLOR))


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int32])
def test_numbers_that_are_no_grey_levels_are_refused(kind):
    values = np.linspace(0, 255, 2400).reshape(40, 60).astype(kind)
    with pytest.raises(FrameError, match=f"^a: its pixels are {np.dtype(kind)}; convert it to 8"):
        decode_image(encode(values, ".tif"), "a")


@pytest.mark.parametrize("head", ["P5\n60 40\n{}\n", "P5 # made by us\n#and\n 60\t40\r\n{}\n"])
@pytest.mark.parametrize("maxval", [15, 127, 254, 1023, 4095])
def test_a_pgm_of_another_maximum_is_refused(head, maxval):
    """OpenCV passes its scale over: levels of 0 to 15 are nearly black."""
    bytes_each = 1 if maxval < 256 else 2
    data = head.format(maxval).encode() + b"\x01" * (2400 * bytes_each)
    with pytest.raises(FrameError, match=f"^a: its brightest level is {maxval}, .*; convert it"):
        decode_image(data, "a")
    assert decode_image(head.format(255).encode() + b"\x01" * 2400, "a").max() == 1


def chunk(name: bytes, data: bytes) -> bytes:
    whole = name + data
    return len(data).to_bytes(4, "big") + whole + zlib.crc32(whole).to_bytes(4, "big")


def hand_png(depth: int, colour_type: int, rows: Image, *chunks: bytes) -> bytes:
    """A PNG of 64x40 pixels of any of its kinds; `rows` are their bytes."""
    size = (64).to_bytes(4, "big") + (40).to_bytes(4, "big")
    header = chunk(b"IHDR", size + bytes([depth, colour_type, 0, 0, 0]))
    pixels = chunk(b"IDAT", zlib.compress(np.insert(rows, 0, 0, axis=1).tobytes()))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunks) + pixels + chunk(b"IEND", b"")


PALETTE = chunk(b"PLTE", np.random.default_rng(2).bytes(48))
EXIF_TURNED = (
    b"MM\x00*\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06" + b"\x00" * 6
)
"""TIFF tags as EXIF keeps them; orientation 6: a quarter turn."""


@pytest.mark.parametrize("depth", [1, 2, 4])
def test_few_bits_a_pixel_fill_the_range(depth):
    packed = np.random.default_rng(3).integers(0, 256, (40, 8 * depth), np.uint8)
    bits = np.unpackbits(packed, axis=1).reshape(40, 64, depth)
    levels = bits @ (1 << np.arange(depth)[::-1])
    assert np.array_equal(
        decode_image(hand_png(depth, 0, packed), "a"), levels * 255 // (2**depth - 1)
    )
    colours = np.frombuffer(PALETTE[8:56], np.uint8).reshape(16, 3)
    image = decode_image(hand_png(depth, 3, packed, PALETTE), "a")
    assert np.array_equal(image, colours[levels][..., ::-1])


SHOWN = {
    "gray": (hand_png(8, 0, np.full((40, 64), 9, np.uint8)), True),
    "palette": (hand_png(4, 3, np.full((40, 32), 17, np.uint8), PALETTE), True),
    "colour": (hand_png(8, 2, np.full((40, 192), 9, np.uint8)), True),
    "alpha": (hand_png(8, 6, np.full((40, 256), 9, np.uint8)), False),
    "gray alpha": (hand_png(8, 4, np.full((40, 128), 9, np.uint8)), False),
    "a transparent level": (
        hand_png(8, 0, np.full((40, 64), 9, np.uint8), chunk(b"tRNS", b"\x00\x09")),
        False,
    ),
    "16 bits": (hand_png(16, 0, np.full((40, 128), 90, np.uint8)), False),
    "turned": (hand_png(8, 0, np.full((40, 64), 9, np.uint8), chunk(b"eXIf", EXIF_TURNED)), False),
    "animated": (
        hand_png(8, 0, np.full((40, 64), 9, np.uint8), chunk(b"acTL", b"\x00\x00\x00\x02" * 2)),
        False,
    ),
}


@pytest.mark.parametrize("kind", SHOWN)
def test_a_browser_shows_plain_pictures_as_they_are_decoded(kind):
    data, alike = SHOWN[kind]
    assert is_shown_alike(data) is alike
    only_a_frame_error(data)


def turned(jpeg: bytes) -> bytes:
    payload = b"Exif\x00\x00" + EXIF_TURNED
    return jpeg[:2] + b"\xff\xe1" + (len(payload) + 2).to_bytes(2, "big") + payload + jpeg[2:]


def test_a_picture_is_turned_as_it_says(gray):
    """As browsers show it: what is labelled is what is learnt from."""
    jpeg = encode(gray, ".jpg")
    assert np.array_equal(decode_image(turned(jpeg), "a"), np.rot90(decode_image(jpeg, "a"), -1))
    rows = np.random.default_rng(4).integers(0, 256, (40, 64), np.uint8)
    png = hand_png(8, 0, rows, chunk(b"eXIf", EXIF_TURNED))
    assert np.array_equal(decode_image(png, "a"), np.rot90(rows, -1))
