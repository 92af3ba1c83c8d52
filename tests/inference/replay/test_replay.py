"""`tokt replay`: the same bundle gives the same verdicts, and what is not the same is told."""

import json
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.calls import call_tokt, refused, succeeds
from tests.inference.conftest import write_mission
from tests.inference.live import HandSource
from tests.inference.logged_runs import (
    Seconds,
    Switch,
    lines,
    log_folder,
    log_run,
    mission_source,
    stereo_start,
    texture_start,
    variant,
    write_lines,
)
from tests.inference.policy import named_object
from tests.inference.stereo.plain_rig import HEIGHT, PLAIN, WIDTH
from tests.inference.swimming import school
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import open_mission
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.policy.assembly import StereoSetup
from tokt.inference.publisher import Observer
from tokt.inference.recording.recorder import Recorder
from tokt.inference.recording.run_log import events_path
from tokt.inference.recording.run_start import used_file
from tokt.inference.replay.replay import BEFORE
from tokt.inference.sources.files import MissionSource
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.calibration_writer import write_calibration
from tokt.models.bundle.bundle import read_bundle
from tokt.models.operating_point import MofNRule
from tokt.models.store.store import Store

Mission = Callable[..., Path]
TWO_OF_THREE = MofNRule(m=2, n=3)
SCENES = [[], [(4, 4)], [(4, 4)], [], [(2, 7)], [], [], [(4, 4), (5, 5)], [(5, 5)], []]


@pytest.fixture
def ruled(bundle_file, tmp_path):
    """A model whose rule looks at three frames."""
    return variant(bundle_file, tmp_path / "ruled.tokt", rule=TWO_OF_THREE)


@pytest.fixture
def log(tmp_path):
    return tmp_path / "run.jsonl"


@pytest.fixture
def logged(make_mission, log):
    """Log a model's run over scenes; the folder of its frames."""

    def run(scenes: list[Any], bundle: Path, **start: Any) -> Path:
        folder = make_mission(scenes)
        log_folder(folder, bundle, log, **start)
        return folder

    return run


def replayed(*arguments: object, code: int = 0) -> dict[str, Any]:
    ran = call_tokt("replay", *arguments, "--json")
    assert ran.code == code, ran.err + ran.out
    return dict(json.loads(ran.out))


def test_the_same_bundle_gives_the_same_verdicts(make_mission, ruled, log):
    folder = make_mission(SCENES)
    (folder / "Left" / "t_L_6.jpg").unlink()
    (folder / "Left" / "t_L_9.jpg").write_bytes(b"no picture")
    source = MissionSource(open_mission(folder), SYSTEM_CLOCK, frames=[1, 2, 3, 5, 6, 7, 8, 9, 10])
    log_run(source, texture_start(folder, ruled), log, SYSTEM_CLOCK, read_bundle(ruled))
    said = [(line["status"], line["reason"]) for line in lines(log)]
    assert said[2] == (1, "ok") and (-1, "unreadable") in said and (-1, "missing") in said
    assert (-1, "frame_rule") in said
    found = replayed(log)
    assert found["same"] and found["compared"] == found["same_to_the_bit"] == 9
    assert not found["not_compared"] and not found["differences"] and not found["notes"]
    assert replayed(log, "--bundle", ruled)["model"] == "the run's own"


def test_a_named_object_is_named_anew_where_its_picture_is_there(make_mission, ruled, log):
    folder = make_mission([[]] * 8)
    for number in range(1, 9):
        seen = [] if number == 6 else [named_object.own(120 + 4 * number)]
        cv2.imwrite(
            str(folder / "Left" / f"t_L_{number}.jpg"), named_object.picture(*seen, seed=number)
        )
    named = {"named": "1:94,90,60,84"}
    log_folder(folder, ruled, log, how=named)
    states = [(line["anchor"], line["anchor_x"] is None) for line in lines(log)]
    held, not_held = ("held", False), ("searching", True)
    assert states == [*[not_held] * 2, *[held] * 3, not_held, *[held] * 2]
    assert replayed(log)["same_to_the_bit"] == 8
    told = lines(events_path(log))
    changed = [line | {"anchor_x": 0.9} if line["anchor_x"] else line for line in lines(log)]
    write_lines(log, changed)
    assert "anchor_x" in replayed(log, code=1)["differences"][0]["fields"]
    for damage in ({"mark": "00000000"}, {"frame": 99}, {"frame": None}, {"box": [0, "a"]}):
        broken = [{**line, **damage} if line["event"] == "object_named" else line for line in told]
        write_lines(events_path(log), broken)
        assert replayed(log)["same_to_the_bit"] == 8  # the anchor is left out
    write_lines(log, [{k: v for k, v in line.items() if k != "anchor"} for line in changed])
    write_lines(events_path(log), [line for line in told if line["event"] != "object_named"])
    assert replayed(log, code=1)["compared"] == 8  # as of a log of before
    log.unlink()
    events_path(log).unlink()
    log_folder(folder, ruled, log, how={**named, "named_after": 2})
    assert [line["anchor"] for line in lines(log)][:5] == [None, None, *["searching"] * 2, "held"]
    assert replayed(log)["same_to_the_bit"] == 8


def test_another_bundle_differs_where_it_sees_otherwise(logged, bundle_file, tmp_path, log):
    logged(SCENES, bundle_file)
    blind = variant(bundle_file, tmp_path / "blind.tokt", threshold=10.0)
    found = replayed(log, "--bundle", blind, code=1)
    assert found["model"] == "blind/7" and found["compared"] == 10
    assert found["statuses"]["obstacle"] == {"obstacle": 0, "clear": 5, "unknown": 0}
    assert (found["status_differs"], found["figures_differ"]) == (5, 0)
    stretches = [(each["first"], each["last"], each["frames"]) for each in found["differences"]]
    assert stretches == [(2, 3, 2), (5, 5, 1), (8, 9, 2)]
    assert found["differences"][0]["example"]["status"] == [1, 0]
    Store(tmp_path / "store").deploy(read_bundle(blind))
    assert replayed(log, "--bundle", tmp_path / "store", code=1)["model"] == "blind/7"
    shown = call_tokt("replay", log, "--bundle", blind)
    assert shown.code == 1
    assert "frame 2-3 (2 frames): obstacle (ok) -> clear (ok); " in shown.out
    assert "5 with another status" in shown.out


def test_changed_and_missing_pictures_are_told_and_not_counted(logged, ruled, tmp_path, log):
    folder = logged(SCENES, ruled)
    moved = tmp_path / "elsewhere"
    shutil.move(folder, moved)
    refused("--source", "replay", log)
    assert replayed(log, "--source", moved)["compared"] == 10
    changed = moved / "Left" / "t_L_3.jpg"
    cv2.imwrite(str(changed), cv2.imread(str(changed)), [cv2.IMWRITE_JPEG_QUALITY, 60])
    (moved / "Right" / "t_R_8.jpg").unlink()
    found = replayed(log, "--source", moved, code=1)
    assert found["not_compared"] == {
        "its pictures are not those that were judged": 1,
        "its pictures are not there": 1,
        "what came before it is not known": 4,
    }
    assert found["compared"] == found["same_to_the_bit"] == 4
    assert found["differences"] == [] and not found["same"]


def test_a_model_that_was_exchanged_is_exchanged_at_the_same_frame(
    make_mission, ruled, tmp_path, log
):
    folder = make_mission([[(4, 4)]] * 9)
    blind = variant(ruled, tmp_path / "blind.tokt", threshold=10.0)
    store = Store(tmp_path / "store")
    bundles = [read_bundle(path) for path in (ruled, blind)]
    for bundle in reversed(bundles):
        store.deploy(bundle)
    first, second = bundles
    # At the seventh frame back and forth: the rule knows of no frame before.
    switch = Switch(SYSTEM_CLOCK, {4: second, 6: first, 8: first})
    log_folder(folder, ruled, log, how={"switch": switch}, models_from=str(store.path))
    said = [line["status"] for line in lines(log)]
    assert said == [-1, 1, 1, 0, 0, -1, 1, -1, 1]
    assert [line["seq"] for line in lines(events_path(log))] == [0, 3, 5, 7]
    found = replayed(log)
    assert found["same"] and found["compared"] == 9
    found = replayed(log, "--bundle", ruled, code=1)
    stretches = [(each["first"], each["last"]) for each in found["differences"]]
    assert stretches == [(4, 5), (6, 6), (8, 8)]


def test_lines_that_are_lost_leave_what_comes_after_unknown(logged, ruled, log):
    for _ in range(2):
        logged(SCENES, ruled)
    first = lines(log)[0]["run"]
    both = log.read_text().splitlines(keepends=True)
    # Of the first run the lines 1 to 3 are gone with an older file, of the second 5 is damaged.
    log.write_text("".join(both[3:14]) + '{"half of a\n' + "".join(both[15:]))
    before = "what came before it is not known"
    found = replayed(log)
    assert found["compared"] == found["same_to_the_bit"] == 7
    assert found["not_compared"] == {before: 2} and found["same"] and found["gaps"] == 1
    (note,) = found["notes"]
    assert "not the 1 before it" in note and first in note
    found = replayed(log, "--run", first)
    assert found["run"] == first and found["frames"] == 7
    assert found["gaps"] == 1 and found["notes"] == []
    assert "in 1 place: lines that are lost" in call_tokt("replay", log).out
    assert found["compared"] == 5 and found["not_compared"] == {before: 2}
    # A damaged line before a run's first is none of its own.
    log.write_text('{"half of a\n' + "".join(both[10:]))
    found = replayed(log)
    assert found["compared"] == found["same_to_the_bit"] == 10 and found["gaps"] == 0
    refused(first, "replay", log, "--run", "run-x")


def scene(x: int | None, depth_px: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """An even sea, with a textured square at x in the left view where there is one."""
    left = np.linspace(25, 45, WIDTH)[None].repeat(HEIGHT, 0)
    left = left.round() + np.random.default_rng(x or 1).integers(0, 2, left.shape)
    right = left.copy()
    if x is not None:
        texture = cv2.resize(np.random.default_rng(3).uniform(20, 120, (80, 80)), (320, 320))
        left[350:670, x : x + 320] = texture
        right[350:670, x - depth_px : x - depth_px + 320] = texture
    return left.astype(np.uint8), right.astype(np.uint8)


@pytest.fixture(scope="module")
def rig(tmp_path_factory, bundle_file):
    """Seven pairs of an approach, a model that can judge them, and the calibration."""
    folder = tmp_path_factory.mktemp("rig")
    for number, x in enumerate([None, *range(700, 646, -9)], 1):
        views = scene(x, 150 if x is None else 150 + (700 - x) // 2)
        for side, view in zip(("Left", "Right"), views, strict=True):
            (folder / "dive" / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / "dive" / side / f"t_{side[0]}_{number}.png"), view)
    write_calibration(folder / "rig.yml", PLAIN, {})
    fitting = variant(bundle_file, folder / "fitting.tokt", golden=scene(None)[0])
    return folder / "dive", fitting, folder / "rig.yml"


@pytest.mark.parametrize("policy", ["either", "fallback"])
def test_pairs_late_durations_and_speeds_come_out_the_same(policy, rig, hand_clock, log):
    folder, bundle, calibration = rig
    stereo = StereoSetup(load_calibration(calibration))
    start = stereo_start(texture_start(folder, bundle), policy, used_file(calibration))
    source = mission_source(folder, hand_clock, rate=5.0)
    late = Seconds(0.7003, *[0.2] * 3, *[0.51234567] * 3)
    log_run(source, start, log, hand_clock, read_bundle(bundle), stereo, stopwatch=late)
    said = lines(log)
    if policy == "either":
        assert any(line["closing_m_s"] is not None for line in said)
        assert {line["method"] for line in said[1:]} <= {"texture+disparity", "texture"}
    else:
        assert "late: 700 ms" in said[0]["health"] and said[0]["texture_s"] == 0.7003
    found = replayed(log)
    assert found["same"] and found["compared"] == 7, found


def test_a_run_that_began_without_a_model_comes_out_the_same(rig, log):
    folder, bundle, calibration = rig
    model, stereo = read_bundle(bundle), StereoSetup(load_calibration(calibration))
    fault = "bundle x.tokt: truncated"
    start = stereo_start(texture_start(folder, bundle), "fallback", used_file(calibration))
    start = replace(start, model=None, model_fault=fault)

    def load() -> Any:
        raise ToktError(fault)

    switch = Switch(SYSTEM_CLOCK, {3: model})
    source = MissionSource(open_mission(folder), SYSTEM_CLOCK, frames=[1, 2, 3, 4])
    log_run(source, start, log, SYSTEM_CLOCK, load, stereo, switch=switch)
    said = lines(log)
    # The first pair is water alone, the same in both pictures: not believed.
    assert [line["method"] for line in said] == ["none", "disparity", "texture", "texture"]
    assert fault in said[0]["health"] and fault not in said[2]["health"]
    found = replayed(log)
    assert found["same"] and found["compared"] == 4, found


GROWING = [[(r, c) for r in range(5 - n, 5 + n) for c in range(5 - n, 5 + n)] for n in (1, 2, 3)]
APPROACH = [GROWING[min(index // 6, 2)] for index in range(44)]


def log_approach(folder: Path, bundle: Path, log: Path, clock: Any, switch: Any = None) -> None:
    """Four frames a second of a thing that grows, flickers, and then stays."""
    log_folder(folder, bundle, log, clock, 4.0, {"switch": switch}, anchor=0.1)


@pytest.fixture(scope="module")
def approach(tmp_path_factory):
    scenes = [[] if index in (9, 13) else at for index, at in enumerate(APPROACH)]
    folder = write_mission(tmp_path_factory.mktemp("approach"), scenes)
    (folder / "Left" / "t_L_12.jpg").write_bytes(b"no picture")
    return folder


def test_a_trend_comes_out_the_same_after_flicker_and_an_exchange(
    approach, bundle_file, hand_clock, log
):
    switch = Switch(hand_clock, {21: read_bundle(bundle_file)})
    log_approach(approach, bundle_file, log, hand_clock, switch)
    said = [line["trend"] for line in lines(log)]
    assert said[8:20] == ["growing", None, "growing", None, "growing", None, *["growing"] * 6]
    assert said[20:24] == [None] * 4 and said[-1] == "steady"  # the same model, put in anew
    assert any(line["expansion_contact_s"] is not None for line in lines(log))
    assert lines(log)[0]["anchor_size"] is not None
    found = replayed(log)
    assert found["same"] and found["compared"] == len(APPROACH), found
    # What was said is compared: a trend that was another is told.
    write_lines(log, [{**line, "trend": line["trend"] and "steady"} for line in lines(log)])
    found = replayed(log, code=1)
    assert found["figures_differ"] == said.count("growing")
    assert found["differences"][0]["fields"] == ["trend"]
    # A log of before there were trends has none that could be another.
    new = {"trend", "trend_confidence", "expansion_contact_s", "moving"}
    new |= {"anchor", "anchor_x", "anchor_y", "anchor_size"}
    for path in (log, events_path(log)):
        write_lines(path, [{k: line[k] for k in line if k not in new} for line in lines(path)])
    assert replayed(log)["same_to_the_bit"] == len(APPROACH)


def test_after_lost_lines_a_trend_is_compared_once_its_seconds_are_known(
    approach, bundle_file, hand_clock, log
):
    log_approach(approach, bundle_file, log, hand_clock)
    kept = lines(log)
    del kept[5]
    write_lines(log, kept)
    found = replayed(log)
    assert found["same"] and found["compared"] == len(APPROACH) - 1, found
    # A trend and moving things hang on 4.25 s and 2.4 s: 27 frames. The 33rd is compared again.
    for place, code in ((31, 0), (32, 1)):
        write_lines(log, [*kept[:place], {**kept[place], "trend": "shrinking"}, *kept[place + 1 :]])
        replayed(log, code=code)


def test_a_recording_is_compared_where_enough_of_it_is_known(
    draw_frame, ruled, tmp_path, hand_clock, log
):
    folder = tmp_path / "dive"
    folder.mkdir()
    for number in range(1, 17):
        picture = draw_frame([(4, 4)] if number in (1, 2, 11, 12, 13) else [], number)
        cv2.imwrite(str(folder / f"t_{number}.png"), picture)

    def recorder(run: str) -> list[Observer]:
        return [Recorder(tmp_path / "kept", run, hand_clock, 0.5, 0.5, 100.0, 0.0)]

    started = {"model_note": "the last good model", "record": str(tmp_path / "kept")}
    run = log_folder(folder, ruled, log, hand_clock, 5.0, {"observers": recorder}, **started)
    kept = tmp_path / "kept" / run
    numbers = open_mission(kept).frames()
    assert numbers == [1, 2, 3, 4, 5, *range(10, 17)]
    shutil.rmtree(folder)
    assert "the last good model" in lines(log)[0]["health"]
    found = replayed(kept)
    before = {"what came before it is not known": 2}
    assert (found["frames"], found["compared"], found["same_to_the_bit"]) == (12, 10, 10)
    assert found["not_compared"] == before and found["same"]
    # The log with the recording's pictures: what was not recorded is not there.
    found = replayed(log, "--source", kept, code=1)
    assert found == replayed(log, code=1)
    assert found["compared"] == found["same_to_the_bit"] == 10
    assert found["not_compared"] == {"its pictures are not there": 4, **before}
    blind = variant(ruled, tmp_path / "blind.tokt", 10.0, TWO_OF_THREE)
    found = replayed(kept, "--bundle", blind, code=1)
    assert found["status_differs"] > 0 and found["not_compared"] == before


def test_a_calibration_that_is_another_one_is_refused(rig, tmp_path, log):
    folder, bundle, calibration = rig
    own = tmp_path / "rig.yml"
    shutil.copy(calibration, own)
    start = stereo_start(texture_start(folder, bundle), "fallback", used_file(own))
    source = MissionSource(open_mission(folder), SYSTEM_CLOCK, frames=[1, 2])
    log_run(source, start, log, SYSTEM_CLOCK, read_bundle(bundle), StereoSetup(PLAIN))
    write_calibration(own, replace(PLAIN, T_mm=PLAIN.T_mm * 1.1), {})
    another = "is not the one that the run had"
    refused(another, "replay", log)
    assert another in succeeds("replay", log, "--calibration", own).err


def test_old_frames_overload_and_a_frozen_camera_in_real_time(
    draw_frame, ruled, tmp_path, hand_clock, log
):
    folder = tmp_path / "dive" / "Left"
    folder.mkdir(parents=True)
    source = HandSource(hand_clock)
    judged = threading.Semaphore(0)

    class Counted(Observer):
        def judged(self, *_: Any) -> None:
            judged.release()

    pictures = [draw_frame(patches, seed) for seed, patches in enumerate(SCENES, 1)]
    shown = [*pictures[:8], *[pictures[8]] * 5]
    for number, picture in enumerate(shown, 1):
        cv2.imwrite(str(folder / f"t_{number}.png"), picture)
    start = texture_start(
        tmp_path / "dive", ruled, live=True, limits=Limits(stale_s=0.4, frozen_repeats=2)
    )

    def give() -> None:
        for number, picture in enumerate(shown, 1):
            hand_clock.now += 0.01
            source.give(picture, age_s=0.7 if number in (3, 4) else 0.0, missed=int(number == 7))
            if number != 5:  # overtaken, perhaps
                judged.acquire()
        source.stop()

    giving = threading.Thread(target=give)
    giving.start()
    log_run(source, start, log, hand_clock, read_bundle(ruled), observers=lambda run: [Counted()])
    giving.join()
    reasons = [line["reason"] for line in lines(log) if line["frame"] is not None]
    assert reasons.count("stale") == 2 and "frozen" in reasons
    found = replayed(log)
    assert found["same"] and found["compared"] == len(reasons), found


def test_other_software_is_told(logged, bundle_file, log):
    logged([[]], bundle_file, software={"tokt": "0.0.9", "kernels": "numpy"})
    said = succeeds("replay", log).err
    assert "tokt 0.0.9" in said and "kernels numpy" in said


def begin_with(log: Path, **fields: object) -> None:
    """Let the log say otherwise how its run began."""
    write_lines(events_path(log), [{**lines(events_path(log))[0], **fields}])


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda log: log.unlink(), "does not exist"),
        (lambda log: events_path(log).unlink(), "run.events.jsonl"),
        (lambda log: events_path(log).write_text(""), "no start event"),
        (lambda log: write_lines(log, [{**lines(log)[0], "status": 7}]), "no status 7"),
        (lambda log: write_lines(log, [{**lines(log)[0], "left": 3}]), "lacks what a replay needs"),
        (lambda log: write_lines(log, [{**lines(log)[0], "seq": "1"}]), "no 'seq'"),
        (lambda log: write_lines(log, []), "no frames"),
        (lambda log: begin_with(log, format_version=99), "newer than this tokt"),
        (lambda log: begin_with(log, limits=1), "start event cannot be read"),
    ],
)
def test_a_log_that_cannot_be_replayed_is_one_clear_line(logged, damage, words, bundle_file, log):
    logged([[]], bundle_file)
    damage(log)
    assert refused(words, "replay", log).count("\n") == 1


def test_a_bundle_that_is_another_one_is_not_taken_for_the_run_s(logged, ruled, bundle_file, log):
    logged([[]], ruled)
    shutil.copy(bundle_file, ruled)
    refused("is not the bundle that ran", "replay", log)


@pytest.fixture
def schooled(tmp_path):
    """Frames of a school before a scene of blocks that goes by; none of it looks like another."""
    rng = np.random.default_rng(5)
    blocks = 30 + 6 * rng.integers(0, 3, (60, 60)).repeat(8, axis=0).repeat(8, axis=1)
    folder = tmp_path / "school"
    folder.mkdir()
    for step in range(24):
        picture = blocks[2 * step :, 3 * step :][:271, :360].astype(np.uint8)
        picture[step, step] += 1
        for one in school(1, 8):
            replace(one, half=(22, 11)).draw(picture, np.zeros_like(picture), step)
        cv2.imwrite(str(folder / f"t_{step + 1}.png"), picture)
    return folder


def test_moving_things_come_out_the_same(schooled, bundle_file, hand_clock, log):
    log_folder(schooled, bundle_file, log, hand_clock, 4.0)
    said = lines(log)
    assert [line["moving"] for line in said[:3]] == [None] * 3 and said[3]["moving"] > 0
    assert {(line["status"], line["reason"]) for line in said} >= {(1, "ok"), (-1, "moving")}
    found = replayed(log)
    assert found["same"] and found["compared"] == len(said), found
    # What was said is compared.
    write_lines(log, [{**line, "moving": line["moving"] and 0.5} for line in said])
    found = replayed(log, code=1)
    assert found["differences"][0]["fields"] == ["moving"]
    # Where frames before are lost, what hangs on them is not.
    write_lines(log, [line for place, line in enumerate(said) if place != 5])
    found = replayed(log)
    assert found["not_compared"][BEFORE] == sum(line["reason"] == "moving" for line in said[6:])


def test_a_log_of_before_things_moved_comes_out_the_same(schooled, bundle_file, hand_clock, log):
    log_folder(schooled, bundle_file, log, hand_clock, 4.0, moving=None)
    for path in (log, events_path(log)):
        write_lines(path, [{k: line[k] for k in line if k != "moving"} for line in lines(path)])
    found = replayed(log)
    assert found["same"] and found["compared"] == 24, found
