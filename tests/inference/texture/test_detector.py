import cv2
import numpy as np
import pytest

from tokt.features.extractors.extractor import gray_picture
from tokt.features.frames.grid import Grid
from tokt.features.frames.image_file import decode_image, read_image
from tokt.inference.frame import Frame
from tokt.inference.frame_checks import frame_fault
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import read_bundle


def test_a_real_bundle_is_a_scorer(bundle_file, draw_frame):
    bundle = read_bundle(bundle_file)
    picture = draw_frame([(2, 3)], seed=5)
    found = TextureDetector(bundle).detect(Frame(1, 0.0, picture, None))
    assert found.mask is not None and found.model == "noise/7"
    assert found.mask[54:81, 108:144].all() and found.mask.sum() == 255 * 27 * 36
    np.testing.assert_array_equal(found.decision_values, bundle.decision_values(picture))
    described = bundle.extractor.describe(picture, bundle.grid)
    np.testing.assert_array_equal(found.features, described)
    np.testing.assert_array_equal(bundle.model.decision_values(described), found.decision_values)
    picture[:] = draw_frame([(7, 9)], seed=6)  # as a camera does: another one in the same buffer
    again = TextureDetector(bundle).detect(Frame(2, 0.0, picture, None))
    assert again.mask.sum() == 255 * 27 * 36 and not again.mask[54:81].any()


@pytest.mark.parametrize(
    ("width", "height", "fit"),
    [
        (1360, 1024, True),
        (1360, 1030, True),
        (1360, 980, False),  # another aspect ratio
        (1024, 771, True),
        (1000, 753, False),  # under 0.75 of the training frames' width
        (1800, 1355, True),
        (1820, 1370, False),  # over 1.33 of it
        (64, 48, False),
    ],
)
def test_frames_unlike_the_training_frames_are_unknown(noise_scorer, width, height, fit):
    noise_scorer.frame_sizes = ((480, 640), (1024, 1360))
    found = TextureDetector(noise_scorer).detect(Frame(1, 0.0, noisy(60, 9, height, width), None))
    assert (found.mask is not None) == fit
    fault = f"frames are {width}x{height}, the model learnt from 640x480 or 1360x1024"
    assert found.fault == ("" if fit else fault)


def test_frames_narrower_than_the_grid_are_unknown_unless_learnt_from(noise_scorer):
    frame = Frame(1, 0.0, noisy(60, 9, 240, 320), None)
    noise_scorer.frame_sizes = ((300, 400),)
    assert "320x240" in TextureDetector(noise_scorer).detect(frame).fault
    noise_scorer.frame_sizes = ((240, 320),)
    assert TextureDetector(noise_scorer).detect(frame).fault == ""


def noisy(mean: float, sigma: float, height: int = 200, width: int = 300) -> np.ndarray:
    """Noise, and light that falls off to one side."""
    rng = np.random.default_rng(1)
    light = mean * np.linspace(0.7, 1.3, width)
    return (light + sigma * rng.standard_normal((height, width))).clip(0, 255).astype(np.uint8)


def test_what_is_no_picture_of_8_bits_cannot_be_judged():
    for shape, kind in (((200, 300), "u2"), ((0, 300), "u1"), ((200, 300, 4), "u1")):
        assert "8-bit" in frame_fault(np.zeros(shape, kind))


def hot_pixels(share: float, depth: tuple[int, ...]) -> np.ndarray:
    """A black frame of a camera with a few pixels that are always bright."""
    rng = np.random.default_rng(1)
    frame = rng.integers(0, 4, (1024, 1360, *depth)).astype(np.uint8)
    frame[rng.random((1024, 1360)) < share] = 255
    return frame


@pytest.mark.parametrize("depth", [(), (3,)])
@pytest.mark.parametrize("share", [0.0003, 0.0006])
def test_hot_pixels_do_not_light_a_black_frame(share, depth):
    assert "dark" in frame_fault(hot_pixels(share, depth))


@pytest.mark.parametrize(("mean", "sigma"), [(251, 8), (255, 25), (258, 40)])
def test_noise_does_not_hide_saturation(mean, sigma):
    assert "saturated" in frame_fault(noisy(mean, sigma, 1024, 1360))


@pytest.mark.parametrize("shape", [(1, 4000), (3, 4000, 3), (400_000, 400)])
def test_a_frame_without_a_resize_is_a_fault_and_no_exception(shape):
    assert "cannot be looked at" in frame_fault(np.zeros(shape, np.uint8))


@pytest.mark.parametrize("width", [360, 361, 800])
@pytest.mark.parametrize("grid", [Grid(), Grid(7, 5), Grid(20, 20, 720), Grid(1, 1, None)])
@pytest.mark.parametrize("covered", [True, False])
def test_the_check_is_the_same_with_a_picture_at_hand(width, grid, covered):
    picture = noisy(60, 9, width * 2 // 3, width)
    if covered:
        picture[width // 3 :, : width // 2] = 60
    fault = frame_fault(picture)
    assert fault == frame_fault(picture, gray_picture(picture, grid), grid)
    assert ("patches are blank" in fault) == covered


def test_a_picture_of_another_width_is_not_what_is_looked_at():
    picture, black = noisy(60, 9, 480, 640), np.zeros((360, 480), np.uint8)
    assert frame_fault(picture, black, Grid(10, 10, 480)) == ""
    assert "dark" in frame_fault(picture, black[:255, :340], Grid(10, 10, 340))  # about as wide
    # Narrower than the patches were measured on: looked at as it is, and not enlarged.
    assert frame_fault(noisy(60, 9), black, Grid()) == ""


def test_a_dim_frame_can_be_judged():
    assert frame_fault(noisy(12, 3)) == ""


def with_blank_patches(count: int, grey: int) -> np.ndarray:
    """A frame of 10x10 patches of 30x20 pixels, some of one grey level."""
    frame = noisy(60, 9)
    for column in range(count):
        frame[180:, 30 * column : 30 * (column + 1)] = grey
    return frame


@pytest.mark.parametrize("grey", [0, 60, 128, 249])
def test_blank_patches_are_damage(grey):
    assert frame_fault(with_blank_patches(2, grey)) == ""
    fault = "3 of 100 patches are blank: the picture is damaged or covered"
    assert frame_fault(with_blank_patches(3, grey)) == fault


@pytest.mark.parametrize("grey", [250, 255])
def test_a_close_bright_object_is_no_damage(grey):
    assert frame_fault(with_blank_patches(10, grey)) == ""


def test_ready_cut_patches_are_too_small_to_look_for_blanks_in():
    frame = noisy(60, 9, 27, 36)
    frame[:9] = 60
    assert frame_fault(frame) == ""


@pytest.mark.mission
@pytest.mark.parametrize("part", [0.2, 0.5, 0.9])
def test_a_jpeg_that_lost_its_tail_but_has_an_end_marker_is_refused(mission, part):
    data = (mission / "Left" / "tokt1_L_180.jpg").read_bytes()
    frame = decode_image(data[: int(part * len(data))] + b"\xff\xd9", "cut.jpg")
    assert "the picture is damaged" in frame_fault(frame)


@pytest.mark.mission
@pytest.mark.parametrize("suffix", [".bmp", ".ppm", ".tiff"])
def test_a_picture_with_zeroed_data_is_refused(mission, suffix):
    frame = read_image(mission / "Left" / "tokt1_L_180.jpg")
    plain = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if suffix == ".tiff" else []
    data = bytearray(cv2.imencode(suffix, frame, plain)[1].tobytes())
    half = len(data) // 2
    data[half : half + len(data) // 4] = bytes(len(data) // 4)
    assert "the picture is damaged" in frame_fault(decode_image(bytes(data), f"cut{suffix}"))


@pytest.mark.mission
@pytest.mark.study
def test_frames_of_the_sea_trial_can_be_judged(mission):
    paths = sorted(mission.glob("*/*.jpg"))
    assert len(paths) == 492
    assert {frame_fault(read_image(path)) for path in paths[::6]} == {""}
