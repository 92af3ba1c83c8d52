"""The end of a training: five lines of what came of it, and frames that a run would refuse."""

import cv2
import numpy as np

from tests.fixtures import draw_tiny_frame, write_labels
from tokt.training.fitting.result_words import at_sea_in_words

NAMES = ["Made", "How good", "At sea", "Not known", "Next"]


def test_a_training_ends_with_five_lines_after_its_figures(done, workspace):
    where = ("--folds", 3, "--embargo", 1, "--workspace", workspace)
    out = done("train", "tiny", "--extractor", "lbp", "--preset", "plain", *where).out
    lines = out.splitlines()
    assert [line.partition(":")[0] for line in lines[-5:]] == NAMES
    made, good, sea, unknown, then = lines[-5:]
    assert made.startswith("Made: tiny-lbp/") and "40 frames of tiny" in made
    assert "in frames that it did not learn from it finds" in good and "(F1 0." in good
    assert "it warned in" in sea and "frames of open water" in sea
    assert "another dive" in unknown and "tokt evaluate tiny-lbp/" in then
    # Figures come first, the paragraph of method after them.
    assert out.index("obstacle patches: F1") < out.index("how this was measured: ")
    assert "a run would call 0 of the 40 labelled frames unknown" in out


def test_frames_that_a_run_would_refuse_are_counted_with_their_reasons(done, told, tmp_path):
    folder = tmp_path / "dive"
    folder.mkdir()
    for frame in range(1, 41):
        picture = draw_tiny_frame(frame)
        if frame in (2, 22):
            picture = np.full_like(picture, 255)
        cv2.imwrite(str(folder / f"dive_{frame}.png"), picture)
    rows = [
        ["dive", "left", frame, row, col, "reef" if (frame // 5) % 2 else "ocean"]
        for frame in range(1, 41)
        for row in range(10)
        for col in range(10)
    ]
    labels, where = write_labels(tmp_path / "labels.csv", rows), ("--workspace", tmp_path / "ws")
    source = ("--mission", folder, "--labels", labels, "--block", 5)
    done("dataset", "build", "dive", *source, *where)
    trained = told("train", "dive", "--extractor", "lbp", "--preset", "plain", *where)
    which = {"dive": "2,22"}
    unseen = {"frames": 40, "reasons": {"saturated": 2}, "which": which}
    assert trained["cv"]["unseen"] == unseen
    shown = done("train", "dive", "--extractor", "lbp", "--preset", "plain", *where).out
    assert "a run would call 2 of the 40 labelled frames unknown" in shown
    assert "where it finds no obstacle (dive 2,22)" in shown
    assert "unknown: 2 saturated" in shown


def test_words_of_the_sea_claim_nothing_that_was_not_tested():
    frames = {"ocean_frames": 0, "false_status": 0, "obstacle_frames": 11, "detected": 9}
    assert "9 of 11 frames with an obstacle" in at_sea_in_words(frames)
    assert "is not known" in at_sea_in_words(frames)
    water = {"ocean_frames": 7, "false_status": 1, "obstacle_frames": 0, "detected": 0}
    assert at_sea_in_words(water).startswith("no frame with an obstacle is labelled")
    assert "1 of 7 frames of open water" in at_sea_in_words(water)
    for nothing in (None, {**frames, "obstacle_frames": 0}):
        assert at_sea_in_words(nothing).startswith("not known")
