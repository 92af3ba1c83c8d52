"""Which frames to label next."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tokt.labels.page.suggestions.queue import next_frames
from tokt.labels.page.suggestions.suggestion_table import MissionSuggestions

PATCHES = 20


def dive(
    n: int, unsure: dict[int, int], cameras: tuple[str, ...] = ("left",)
) -> MissionSuggestions:
    """Frames 1..n that look slowly different; so many patches of some frames are unsure."""
    rng = np.random.default_rng(3)
    number = np.arange(1, n + 1)
    slow = np.stack([np.sin(number / (9 + 3 * k) + k) for k in range(8)], axis=1)
    features = np.tile(slow, (len(cameras), 1)) + rng.normal(0, 0.03, (n * len(cameras), 8))
    values = rng.uniform(2, 6, (n * len(cameras), PATCHES))
    for frame, patches in unsure.items():
        values[frame - 1, :patches] = np.linspace(0.02, 0.3, patches)
    return MissionSuggestions(
        np.repeat(cameras, n), np.tile(number, len(cameras)), values, features.astype(np.float32)
    )


def names(queue):
    return [(entry.camera, entry.frame) for entry in queue]


def points_of(known):
    """The frames in units of standard deviations, computed here anew."""
    x = known.features.astype(np.float64)
    return (x - x.mean(axis=0)) / x.std(axis=0) / np.sqrt(x.shape[1])


def test_neighbours_of_one_uncertain_frame_do_not_fill_the_top():
    burst = {frame: 15 for frame in range(50, 58)}
    known = dive(300, {**burst, 120: 8, 200: 8, 280: 8})
    top = [entry.frame for entry in next_frames(known, [], 4)]
    assert sum(frame in burst for frame in top) == 1
    assert {120, 200, 280} < set(top)


def test_a_dive_that_is_clear_and_not_seen_has_a_queue():
    known = dive(30, {})
    known.values[:] = np.nan
    queue = next_frames(known, [], 3)
    assert len(queue) == 3 and queue[0].why.startswith("no patches within 0 of the threshold")


def test_without_near_copies_the_most_uncertain_come_first():
    known = dive(300, {40: 3, 120: 18, 200: 8})
    assert [entry.frame for entry in next_frames(known, [], 3)] == [120, 200, 40]


def test_labelled_frames_are_out_and_their_near_copies_late():
    known = dive(300, {50: 15, 51: 15, 150: 9, 250: 9})
    labelled = [("left", 50), ("right", 250)]
    queue = next_frames(known, labelled, 300)
    assert len(queue) == 299 and ("left", 50) not in names(queue)
    assert [entry.frame for entry in queue[:1]] == [150]
    assert names(queue).index(("left", 51)) > 10


def test_the_frame_that_is_shown_counts_as_known():
    known = dive(300, {50: 15, 51: 15, 150: 9})
    queue = next_frames(known, [], 10, now=("left", 50))
    assert queue[0].frame == 150 and not {50, 51} & {entry.frame for entry in queue}


def test_the_other_cameras_picture_of_the_same_moment_comes_late():
    known = dive(100, {30: 10, 70: 9}, ("left", "right"))
    known.values[130 - 1, :10] = known.values[30 - 1, :10]
    top = names(next_frames(known, [], 2))
    assert top[0] in [("left", 30), ("right", 30)] and top[1] == ("left", 70)


def test_scores_fall_and_every_frame_comes_once():
    known = dive(120, {20: 4, 60: 12})
    queue = next_frames(known, [("left", 7)], 1000)
    scores = [entry.score for entry in queue]
    assert scores == sorted(scores, reverse=True) and 0 <= scores[-1] <= scores[0] <= 1
    assert sorted(names(queue)) == [("left", frame) for frame in range(1, 121) if frame != 7]
    assert queue == next_frames(known, [("left", 7)], 1000)
    assert next_frames(known, [], 0) == [] and len(next_frames(known, [], 5)) == 5


def test_when_all_is_labelled_or_nothing_is_known_the_queue_is_empty():
    known = dive(5, {})
    assert next_frames(known, [("left", frame) for frame in range(1, 6)], 3) == []
    nothing = MissionSuggestions(
        np.zeros(0, str), np.zeros(0, np.int64), np.zeros((0, 4)), np.zeros((0, 2), np.float32)
    )
    assert next_frames(nothing, [], 3) == []


WHY = re.compile(
    r"(\d+|no) patch(?:es)? within ([\d.]+) of the threshold; "
    r"(?:looks (most like|unlike anything (?:labelled|shown now|before it here| or )+)"
    r" \(?(?:nearest: )?frame (\d+)\)?|nothing to compare it with is labelled yet)"
)


@pytest.mark.parametrize("now", [None, 60, 88])
@pytest.mark.parametrize("labelled", [[], [88], [20, 88, 89, 140, 210]])
def test_the_reasons_are_true(labelled, now):
    known = dive(300, {30: 1, 50: 15, 51: 14, 150: 9, 250: 7})
    shown = ("left", now) if now else None
    queue = next_frames(known, [("left", frame) for frame in labelled], 60, shown)
    also = {now} - {None, *labelled}
    points, earlier = points_of(known), [*labelled, *also]
    kinds = set()
    for entry in queue:
        said = WHY.fullmatch(entry.why)
        assert said, entry.why
        within = known.values[entry.frame - 1] <= float(said[2])
        assert (0 if said[1] == "no" else int(said[1])) == within.sum()
        kinds.add(said[3])
        if not earlier:
            assert said[4] is None
        else:
            away = np.linalg.norm(points[np.array(earlier) - 1] - points[entry.frame - 1], axis=1)
            assert away[earlier.index(int(said[4]))] == pytest.approx(away.min(), rel=1e-3)
            assert (said[3] == "most like") == (away.min() < 1.0)
            unlike = said[3] != "most like"
            assert ("before it" in said[3]) == (unlike and entry != queue[0])
            assert ("labelled" in said[3]) == (unlike and bool(labelled))
            assert ("shown" in said[3]) == (unlike and bool(also))
        earlier.append(entry.frame)
    assert "most like" in kinds and any(kind and "unlike" in kind for kind in kinds)
    ones = [entry for entry in queue if entry.frame == 30]
    assert ones and ones[0].why.startswith("1 patch within ")


def test_with_two_cameras_and_several_classes_the_reason_says_so():
    known = dive(60, {30: 5}, ("left", "right"))
    several = replace(known, several=True)
    (entry,) = next_frames(several, [("right", 10)], 1)
    assert re.match(r"5 patches within [\d.]+ of a second class; looks ", entry.why)
    assert re.search(r"(left|right) frame 10\)?$", entry.why)


def test_margins_of_any_size_will_do():
    small = dive(100, {30: 5, 60: 9})
    large = replace(small, values=small.values * 1e4)
    none = replace(small, values=np.zeros((100, PATCHES)))
    assert names(next_frames(small, [], 20)) == names(next_frames(large, [], 20))
    assert next_frames(none, [], 1)[0].why.startswith("20 patches within 0 of the threshold")
