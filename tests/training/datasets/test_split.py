"""Few labelled frames: splits that they can bear, single pictures, and what is still lacking."""

import cv2
import numpy as np
import pandas as pd
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from PIL import Image

from tests.calls import refuses
from tests.fixtures import draw_tiny_frame, write_labels, write_video
from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import open_mission
from tokt.features.frames.single_pictures import why_single_pictures
from tokt.training.datasets.folds import BLOCK_SIZES, LEAST_FRAMES, MAX_BLOCKS_ALONE, embargo_of
from tokt.training.datasets.split import Split, bearable_block, blocks_of, too_few_frames

WATER, REEF = "ocean", "reef"


def patches_of(frames, mission="dive"):
    """A table of labelled patches from the labels of each frame."""
    rows = [(mission, number, label) for number, labels in frames.items() for label in labels]
    table = pd.DataFrame(rows, columns=["mission", "frame", "label"])
    return table, (table.label == REEF).to_numpy(np.int64)


both = st.lists(st.sampled_from([WATER, REEF]), min_size=1, max_size=4)


@settings(max_examples=scaled(60))
@given(st.dictionaries(st.integers(1, 130), both, min_size=1, max_size=30), st.booleans())
def test_labels_bear_a_split_or_it_is_said_what_is_lacking(frames, single):
    table, targets = patches_of(frames)
    pictures = {"dive": "they have 2 sizes"} if single else {}
    block = 1 if single else bearable_block(table, targets, {}, {})
    assert single or block in BLOCK_SIZES
    table = table.assign(group=blocks_of(table, block, pictures))
    asked = Split(5, embargo_of(block), single_pictures=tuple(pictures))
    try:
        split = asked.borne_by(table, targets, block)
    except ToktError as error:
        event("refused")
        lacking = too_few_frames(table, targets, block)
        assert not lacking or str(error) == lacking
        return
    event(f"split in {split.folds}")
    assert table.frame.nunique() >= LEAST_FRAMES and 2 <= split.folds <= MAX_BLOCKS_ALONE
    split.check(table, targets)
    for fold in split.cut(table, targets):
        assert not set(table.group.iloc[fold.train]) & set(table.group.iloc[fold.test])


def borne(frames, block, single=()):
    table, targets = patches_of(frames)
    table = table.assign(group=blocks_of(table, block, single))
    asked = Split(5, embargo_of(block), single_pictures=tuple(single))
    return asked.borne_by(table, targets, block).folds


def test_few_single_pictures_are_held_out_one_by_one_and_more_in_five_folds():
    few = {number: [WATER, REEF] for number in range(1, 7)}
    assert borne(few, 1, ["dive"]) == 6
    assert borne({number: [WATER, REEF] for number in range(1, 12)}, 1, ["dive"]) == 5
    # Neighbour numbers are near copies in a sequence: one block of twenty.
    refuses("each class in 3 blocks", borne, few, 20)


def test_a_short_sequence_has_shorter_blocks_and_three_blocks_are_three_folds():
    table, targets = patches_of({n: [WATER] if n < 30 else [WATER, REEF] for n in range(1, 60)})
    assert bearable_block(table, targets, {}, {}) == 10, "of 20 frames reef is in 2 blocks"
    long, its = patches_of({n: [WATER, REEF] for n in range(1, 60)})
    assert bearable_block(long, its, {}, {}) == 20
    assert borne({n: [WATER, REEF] for n in (1, 5, 25, 30, 45, 50)}, 20) == 3
    # A dive of its own, beside photographs: these have blocks of one frame.
    photos, more = patches_of({n: [WATER, REEF] for n in range(5)}, "photos")
    two, of_both = pd.concat([long, photos]), np.concatenate([its, more])
    assert bearable_block(two, of_both, {}, {"photos": "they have 4 sizes"}) == 20
    assert set(blocks_of(photos, 20, ["photos"])) == {f"photos#{n:05d}" for n in range(5)}


def test_a_dive_that_is_too_small_to_choose_by_is_split_with_the_other_by_blocks():
    long, its = patches_of({n: [WATER, REEF] for n in range(0, 1200, 7)}, "long")
    short, more = patches_of({n: [WATER, REEF] for n in (1, 2, 3)}, "short")
    table, targets = pd.concat([long, short], ignore_index=True), np.concatenate([its, more])
    table = table.assign(group=blocks_of(table, 20, ()))
    by_dive = Split(5, 5, "dive")
    refuses("blocks of frames are too few", by_dive.borne_by, table, targets, 20)
    split = by_dive.borne_by(table, targets, 20, or_blocks=True)
    assert (split.by, split.folds) == ("block", 5)


def test_what_is_lacking_is_counted_and_named():
    table, targets = patches_of({1: [WATER], 2: [WATER, REEF], 3: [WATER], 4: [WATER]})
    words = too_few_frames(table.assign(group=table.frame), targets, 1)
    assert words == (
        "training takes 6 labelled frames or more, and each class in 3 of them; there are 4 "
        "labelled frames. Label 2 more, 2 with reef"
    )
    apart, of_class = patches_of({n: [WATER, REEF] for n in (1, 2, 3, 21, 41)})
    words = too_few_frames(apart.assign(group=blocks_of(apart, 20, ())), of_class, 20)
    assert "there are 5 labelled frames. Label 1 more. A block is 20 frames" in words
    assert words.endswith("If they are single photographs, give tokt dataset build --block 1")


def photographs(folder, sizes, apart_s=None):
    """Write pictures of these widths, with or without the times at which they were taken."""
    folder.mkdir()
    for number, width in enumerate(sizes, 1):
        exif = Image.Exif()
        if apart_s is not None:
            taken = pd.Timestamp("2026-05-01 10:00") + pd.Timedelta(seconds=apart_s * number)
            exif.get_ifd(0x8769)[0x9003] = taken.strftime("%Y:%m:%d %H:%M:%S")
        picture = cv2.resize(draw_tiny_frame(number), (width, 272))
        Image.fromarray(picture).save(folder / f"reef_{number}.jpg", exif=exif)
    return folder


@pytest.mark.parametrize(
    ("sizes", "apart_s", "why"),
    [
        ([360] * 5 + [380] * 5 + [400] * 5, None, "they have 3 sizes"),
        ([360, 380, 380, 360, 360, 360], None, "they have 2 sizes"),
        ([360] * 6, 30, "their cameras took them 30 s apart"),
        ([360] * 6, 2, ""),  # a camera that is set to take one each two seconds
        ([360] * 6, None, ""),
        ([360] * 5 + [380] * 5, None, ""),  # one camera, set anew in the middle of a dive
        ([360], None, ""),
    ],
)
def test_single_pictures_are_told_by_sizes_or_times(sizes, apart_s, why, tmp_path):
    assert why_single_pictures(open_mission(photographs(tmp_path / "reef", sizes, apart_s))) == why


def test_a_video_and_a_stereo_pair_are_sequences(tmp_path):
    video = write_video(tmp_path / "dive.avi", [cv2.merge([draw_tiny_frame(1)] * 3)] * 3)
    assert why_single_pictures(open_mission(video)) == ""
    for side in ("Left", "Right"):
        (tmp_path / "pair").mkdir(exist_ok=True)
        photographs(tmp_path / "pair" / side, [360, 380, 400])
    assert why_single_pictures(open_mission(tmp_path / "pair")) == ""


def test_six_photographs_make_a_model_and_five_are_refused_before_any_work(done, refused, tmp_path):
    folder = photographs(tmp_path / "reef", [360, 380, 400, 360, 380, 400])
    where = ("--workspace", tmp_path / "ws")

    def labels(frames):
        rows = [
            ["reef", "left", frame, row, col, "reef" if col > 6 else "ocean"]
            for frame in frames
            for row in range(10)
            for col in range(10)
        ]
        return write_labels(tmp_path / "labels.csv", rows)

    def build(frames, *more):
        source = ("--mission", folder, "--labels", labels(frames), *more)
        return done("dataset", "build", "reef", *source, *where)

    built = build(range(1, 6))
    words = "training takes 6 labelled frames or more, and each class in 3 of them"
    assert f"WARNING: {words}; there are 5 labelled frames. Label 1 more" in built.err
    said = refused(words, "train", "reef", "--preset", "plain", "--extractor", "lbp", *where)
    assert "features" not in said and not (tmp_path / "ws" / "mlflow.db").exists()
    built = build(range(1, 7))
    assert "single pictures, as they have 3 sizes: each is a block of its own" in built.err
    assert "in 6 frames, each held out alone" in built.out
    made = done("train", "reef", "--preset", "plain", "--extractor", "lbp", *where)
    assert "6-fold cross-validation over 6 single pictures, each held out alone." in made.out
    # Whoever knows better says so: also that pictures of one size are no sequence.
    built = build(range(1, 7), "--block", 1)
    assert "in 6 frames, each held out alone" in built.out and "taken for" not in built.err
    again = done("train", "reef", "--preset", "plain", "--extractor", "lbp", *where)
    assert "over 6 single pictures" in again.out and "WEAK" not in again.out
    built = build(range(1, 7), "--block", 2)
    assert "single pictures" not in built.err and "4 blocks of up to 2 frames" in built.out


def test_a_sequence_that_comes_to_a_model_of_photographs_keeps_its_blocks(done, told, tmp_path):
    where = ("--workspace", tmp_path / "ws")
    widths = {"reef": [360, 380, 400] * 2, "wall": [380, 400, 360] * 2, "dive": [390] * 24}
    folders = {name: photographs(tmp_path / name, sizes) for name, sizes in widths.items()}

    def source(name):
        numbers = range(1, len(widths[name]) + 1)
        rows = [
            [name, "left", frame, row, col, "reef" if col > 6 else "ocean"]
            for frame in numbers
            for row in range(10)
            for col in range(10)
        ]
        labels = write_labels(tmp_path / f"{name}.csv", rows)
        return ("--mission", folders[name], "--labels", labels)

    done("dataset", "build", "all", *source("reef"), *where)
    done("train", "all", "--name", "m", "--preset", "plain", "--extractor", "lbp", *where)
    adapt = ("adapt", "m/1", "--draws", 1, "--jobs", 1, "--force", "a test", *where)
    photos = told(*adapt, *source("wall"))["dataset"]
    both = told("dataset", "show", photos, *where)
    assert both["block_frames"] == 1 and both["groups"] == 12
    built = told("dataset", "build", "all", *source("reef"), *source("wall"), *where)
    assert built["label"] == photos
    dive = told("dataset", "show", told(*adapt, *source("dive"))["dataset"], *where)
    # Frames 1 to 19 and 20 to 24 of the dive are a block each.
    assert dive["block_frames"] == 20 and dive["groups"] == 6 + 2
    assert set(dive["single_pictures"]) == {"reef"}
