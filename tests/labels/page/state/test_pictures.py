"""Frames and patches as the page shows them."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.inference.test_faults import hold_row
from tests.tiers import scaled
from tokt.features.common.errors import FrameError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.page.state.enhance import enhanced, enhanced_small, gain
from tokt.labels.page.state.pictures import PatchPictures, frame_picture

TOWER = np.s_[300:700, 560:620]
BESIDE = np.s_[300:700, 650:710]
EMPTY = np.s_[100:900, 1000:1250]


def decoded(data):
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR), np.uint8)


def water(tower=0.0, noise=0.6):
    """Blue water, brighter to the right, as the mission's; a tower of so many grey levels."""
    light = np.linspace(8, 28, 1360)[None, :] + np.linspace(4, 0, 1024)[:, None]
    light[TOWER] += tower
    rng = np.random.default_rng(1)
    image = light[..., None] * (1.6, 1.0, 0.6) + rng.normal(0, noise, (1024, 1360, 3))
    return np.asarray(image.round().clip(0, 255), np.uint8)


def gray_mean(picture, where):
    return float(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)[where].mean())


def test_half_a_grey_level_of_signal_becomes_visible():
    picture = enhanced(water(tower=0.5), 60)
    assert gray_mean(picture, TOWER) - gray_mean(picture, BESIDE) > 5


def test_nothing_is_not_made_into_something():
    raw, picture = water(), enhanced(water(), 60)
    assert abs(gray_mean(picture, TOWER) - gray_mean(picture, BESIDE)) < 2
    brightness = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    assert cv2.GaussianBlur(brightness, (0, 0), 2)[EMPTY].std() < 4
    assert brightness.std() < 8 < raw.std() + 4


def test_no_halo_around_a_lit_tower():
    picture = enhanced(water(tower=150), 60)
    near = np.s_[300:700, 630:680]
    far = np.s_[300:700, 1000:1100]
    assert abs(gray_mean(picture, near) - gray_mean(picture, far)) < 8
    assert gray_mean(picture, TOWER) > gray_mean(picture, near) + 80


@pytest.mark.parametrize("amount", [-1, 101])
def test_an_enhancement_is_0_to_100(amount):
    for enhance in (enhanced, enhanced_small):
        with pytest.raises(ValueError, match=f"0 to 100, not {amount}"):
            enhance(np.zeros((9, 9), np.uint8), amount)


def test_the_amount_says_how_much():
    frame = water(tower=1.0)
    seen = []
    for amount in (0, 20, 40, 60, 80, 100):
        picture = enhanced(frame, amount)
        seen.append(gray_mean(picture, TOWER) - gray_mean(picture, BESIDE))
    assert seen == sorted(seen)
    assert seen[3] == pytest.approx(gain(60) * 1.0, rel=0.4)
    assert np.array_equal(enhanced(frame, 0), frame)


@pytest.mark.parametrize("light", [1.0, 6.0])
def test_the_cameras_colours_stay(light):
    """In nearly black water as in bright: nothing is greyed, and no colour comes from nowhere."""
    frame = (water(tower=2) * light).clip(0, 255).astype(np.uint8)
    frame[TOWER] = (10, 20, 90)
    frame[BESIDE] = 9
    picture = enhanced(frame, 60)
    inside = ((picture > 0) & (picture < 255)).all(-1)
    assert inside.mean() > 0.9
    for one, other in ((0, 1), (2, 1)):
        was, now = (of[..., one].astype(int) - of[..., other] for of in (frame, picture))
        assert np.abs(now - was)[inside].max() <= 1


SIDES = st.integers(1, 90)


@given(st.tuples(SIDES, SIDES), st.booleans(), st.integers(0, 100), st.integers(0, 2**32 - 1))
@settings(max_examples=scaled(30))
def test_any_frame_can_be_enhanced(size, colour, amount, seed):
    shape = (*size, 3) if colour else size
    frame = np.random.default_rng(seed).integers(0, 256, shape, np.uint8)
    for of in (enhanced, enhanced_small):
        picture = of(frame, amount)
        assert picture.shape == shape and picture.dtype == np.uint8
        if amount == 0:
            assert np.array_equal(picture, frame)


def test_the_small_picture_is_the_large_one_made_small():
    frame = water(tower=3)
    large = cv2.resize(enhanced(frame, 60), (680, 512), interpolation=cv2.INTER_AREA)
    difference = np.abs(large.astype(int) - enhanced_small(frame, 60))
    assert difference.mean() < 1.5


def mission_of(folder, images):
    folder.mkdir()
    for name, image in images.items():
        assert cv2.imwrite(str(folder / name), image)
    return open_mission(folder)


def test_the_cameras_own_file_is_sent_untouched(tmp_path):
    frame = water(tower=5)[:270, 500:860]
    mission = mission_of(tmp_path / "m", {"a_1.jpg": frame, "a_2.png": frame, "a_3.tif": frame})
    for number, name, media in ((1, "a_1.jpg", "image/jpeg"), (2, "a_2.png", "image/png")):
        data, media_type = frame_picture(mission, "left", number, 0)
        assert (data, media_type) == ((tmp_path / "m" / name).read_bytes(), media)
    data, media_type = frame_picture(mission, "left", 3, 0)
    assert media_type == "image/png" and np.array_equal(decoded(data), frame)


def test_a_file_that_browsers_show_otherwise_is_sent_as_it_is_learnt_from(tmp_path):
    """A browser mixes transparent pixels with its own ground, and models do not."""
    frame = water(tower=5)[:270, 500:860]
    alpha = np.dstack([frame, np.arange(frame[..., 0].size).reshape(frame.shape[:2]) % 256])
    images = {"a_1.png": alpha.astype(np.uint8), "a_2.png": frame.astype(np.uint16) * 257}
    mission = mission_of(tmp_path / "m", images)
    for number in (1, 2):
        data, media_type = frame_picture(mission, "left", number, 0)
        shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        assert media_type == "image/png" and shown.dtype == np.uint8
        assert np.array_equal(shown, frame) and np.array_equal(mission.read(number), frame)


@pytest.mark.parametrize("enhance", [0, 60])
def test_a_frame_that_would_be_nearly_black_is_said_and_not_shown(tmp_path, enhance):
    frame = water(tower=5)[:270, 500:860].astype(np.uint16) * 16
    mission = mission_of(tmp_path / "m", {"a_1.png": frame})
    with pytest.raises(FrameError, match=r"upper bits empty.*; convert it to 8 bits"):
        frame_picture(mission, "left", 1, enhance)
    hold_row(
        "12-bit levels in a 16-bit image, to be labelled",
        "not shown; the page names the remedy",
        "nothing",
    )


def test_an_enhanced_frame_is_a_jpeg_of_the_frames_size(tmp_path):
    frame = water(tower=2)
    mission = mission_of(tmp_path / "m", {"a_1.png": frame, "a_2.png": frame[..., 1]})
    for number, shape in ((1, (1024, 1360, 3)), (2, (1024, 1360))):
        data, media_type = frame_picture(mission, "left", number, 60)
        assert media_type == "image/jpeg" and decoded(data).shape == shape
        expected = enhanced(mission.read(number), 60)
        assert np.abs(decoded(data).astype(int) - expected).mean() < 3


def test_a_thumbnail_has_the_width_asked_for(tmp_path):
    mission = mission_of(tmp_path / "m", {"a_1.png": water(tower=2)})
    for enhance, width in ((0, 100), (60, 1000), (0, 2000)):
        data, media_type = frame_picture(mission, "left", 1, enhance, width)
        expected = min(width, 1360)
        assert media_type == "image/jpeg"
        assert decoded(data).shape[:2] == (round(1024 * expected / 1360), expected)


@pytest.mark.parametrize("enhance", [0, 60])
def test_an_unreadable_frame_is_said_and_never_shown_in_part(tmp_path, enhance):
    frame = water(tower=5)
    mission = mission_of(tmp_path / "m", {"a_1.jpg": frame, "a_2.png": frame})
    for name in ("a_1.jpg", "a_2.png"):
        file = tmp_path / "m" / name
        file.write_bytes(file.read_bytes()[:-2000])
    for number in (1, 2, 3):
        for width in (None, 100):
            with pytest.raises(FrameError):
                frame_picture(mission, "left", number, enhance, width)


@pytest.mark.parametrize("cell", [-1, 100])
def test_a_cell_outside_the_grid_is_refused(tiny, cell):
    sprite = PatchPictures(open_mission(tiny.path), Grid()).sprite
    refuses(f"cell is 0 to 99, not {cell}", sprite, [("left", 1, cell)])


def numbered_patches(tmp_path):
    """Frames whose patches each have one grey level: 2 * cell + 10 * frame."""
    levels = np.arange(100, dtype=np.uint8).reshape(10, 10) * 2
    image = levels.repeat(27, 0).repeat(36, 1)
    # One row of pixels more belongs to no patch, as in the real mission.
    image = np.vstack([image, image[-1:]])
    return mission_of(tmp_path / "m", {f"a_{n}.png": image + np.uint8(10 * n) for n in (1, 2, 3)})


def test_a_sprite_shows_the_patches_asked_for_in_that_order(tmp_path):
    mission = numbered_patches(tmp_path)
    cells = [("left", frame, cell) for cell in (99, 0, 45, 9) for frame in (3, 1, 2)]
    data, media_type = PatchPictures(mission, Grid()).sprite(cells, 40, 0, 0)
    sheet = decoded(data)[..., 0]
    assert media_type == "image/jpeg" and sheet.shape == (80, 400)
    for index, (_, frame, cell) in enumerate(cells):
        y, x = (40 * part for part in divmod(index, 10))
        # 36x27 in a tile of 40x40: 5 pixels are free above and below.
        assert sheet[y + 20, x + 20] == pytest.approx(2 * cell + 10 * frame, abs=3)
        assert sheet[y + 1, x + 20] < 12
    assert sheet[60, 300] < 12  # nothing after the last


def test_the_margin_shows_the_surroundings(tmp_path):
    pictures = PatchPictures(numbered_patches(tmp_path), Grid())
    tile = decoded(pictures.sprite([("left", 1, 45)], 80, 1, 0)[0])[:80, :80, 0]
    for row, y in ((3, 20), (4, 40), (5, 60)):
        for col, x in ((4, 13), (5, 40), (6, 66)):
            assert tile[y, x] == pytest.approx(2 * (10 * row + col) + 10, abs=4)
    # At the corner there are no surroundings on two sides.
    corner = decoded(pictures.sprite([("left", 1, 0)], 80, 1, 0)[0])[:80, :80, 0]
    assert corner[20, 20] == pytest.approx(10, abs=4)


def test_an_unreadable_frame_gives_a_crossed_out_tile(tmp_path):
    mission = numbered_patches(tmp_path)
    (tmp_path / "m" / "a_2.png").write_bytes(b"no image")
    pictures = PatchPictures(mission, Grid())
    sheet = decoded(pictures.sprite([("left", n, 45) for n in (1, 2, 3, 9)], 40, 0, 0)[0])[..., 0]
    for tile, crossed in enumerate((False, True, False, True)):
        part = sheet[:40, 40 * tile : 40 * tile + 40]
        assert (part[20, 20] > 140 and abs(int(part[20, 5]) - 70) < 20) == crossed


def test_a_frame_of_fewer_pixels_than_patches_gives_crossed_out_tiles(tmp_path):
    mission = numbered_patches(tmp_path)
    cv2.imwrite(str(tmp_path / "m" / "a_2.png"), np.full((1, 1), 200, np.uint8))
    sheet = decoded(PatchPictures(mission, Grid()).sprite([("left", 2, 99)], 40, 0, 0)[0])[..., 0]
    assert sheet[20, 20] > 140 and abs(int(sheet[20, 5]) - 70) < 20


def test_a_frame_is_decoded_once_for_all_its_patches(tmp_path):
    mission = numbered_patches(tmp_path)
    reads, read = [], mission.read
    mission.read = lambda frame, camera: reads.append(frame) or read(frame, camera)
    pictures = PatchPictures(mission, Grid())
    cells = [("left", frame, cell) for cell in range(20) for frame in (1, 2)]
    first = pictures.sprite(cells)
    assert pictures.sprite(cells) == first and sorted(reads) == [1, 2]


@pytest.mark.mission
def test_the_tower_of_frame_140_can_be_seen(mission_dir):
    frame = open_mission(mission_dir).read(140)
    raw, picture = (cv2.cvtColor(p, cv2.COLOR_BGR2GRAY) for p in (frame, enhanced(frame)))
    # Along its leg, against parallels 60 pixels away on both sides.
    points = np.linspace((330, 850), (560, 760), 40).round().astype(int)

    def contrast(of):
        smooth = cv2.GaussianBlur(of, (0, 0), 4).astype(float)
        leg, left, right = (smooth[points[:, 0], points[:, 1] + dx].mean() for dx in (0, -60, 60))
        return float(leg - max(left, right))

    assert contrast(raw) < 4
    assert contrast(picture) > 8
