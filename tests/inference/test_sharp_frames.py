"""A camera that the model did not learn: unknown with what to do, or clear by its sharp frames."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.calls import refused, refuses, succeeds
from tests.inference.logged_runs import lines
from tokt.features.frames.mission import open_mission
from tokt.features.frames.view_mask import CameraMasks, ViewMask, write_masks
from tokt.inference.frame import Frame
from tokt.inference.monitoring.watchdog import RESTARTS_VARIABLE
from tokt.inference.replay.replay import model_named
from tokt.inference.sharp_frames import MAX_FRAMES, are_mostly_hidden, measure_sharp_frames
from tokt.inference.sight import SightMeter
from tokt.models.bundle.bundle import bundle_bytes, read_bundle
from tokt.models.sight import limits_for, measure_sight


def noisy(height, width):
    """Pictures of a camera with much noise."""
    rng = np.random.default_rng(0)
    return [rng.normal(90, 9, (height, width)).astype(np.uint8) for _ in range(2)]


@pytest.fixture(scope="module")
def model(tiny_bundle, tmp_path_factory):
    """A model that learnt the tiny mission from another camera, one with finer detail."""
    content = read_bundle(tiny_bundle).content
    path = tmp_path_factory.mktemp("other") / "other.tokt"
    path.write_bytes(bundle_bytes(replace(content, sight=measure_sight(noisy(480, 640)))))
    return path


@pytest.fixture(scope="module")
def dive(tiny):
    return tiny.path


@pytest.fixture
def sharp(dive, tmp_path):
    """A folder with some of its frames, as somebody puts it together."""
    (tmp_path / "sharp").mkdir()
    for path in sorted((dive / "Left").glob("*.png"))[:6]:
        shutil.copy(path, tmp_path / "sharp")
    return tmp_path / "sharp"


def run(tmp_path, dive, bundle, *options):
    """What the runtime says of the frames that show no obstacle: status, reason and health."""
    log = tmp_path / "run.jsonl"
    for path in (log, tmp_path / "run.events.jsonl"):
        path.unlink(missing_ok=True)
    succeeds("run", "--bundle", bundle, "--source", dive, "--log", log, *options)
    return [line for line in lines(log) if line["status"] != 1]


def test_of_a_camera_that_it_did_not_learn_a_model_says_why_nothing_is_clear(tmp_path, dive, model):
    found = run(tmp_path, dive, model)
    assert found and {line["status"] for line in found} == {-1}
    for line in found:
        assert "compared with 640x480 frames" in line["health"]
        assert "as none of 360x272 were learnt (--sharp-frames)" in line["health"]


def test_with_sharp_frames_of_the_camera_it_says_clear_and_tells_a_fogged_port(
    tmp_path, dive, sharp, model
):
    before = run(tmp_path, dive, model)
    found = run(tmp_path, dive, model, "--sharp-frames", sharp)
    assert len(found) == len(before)
    assert {line["status"] for line in found} == {0}
    assert {line["reason"] for line in found} == {"ok"}
    fogged = tmp_path / "fogged/Left"
    fogged.mkdir(parents=True)
    for path in (dive / "Left").glob("*.png"):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(fogged / path.name), cv2.GaussianBlur(picture, (0, 0), 5))
    run(tmp_path, fogged.parent, model, "--sharp-frames", sharp)
    judged = lines(tmp_path / "run.jsonl")
    assert len(judged) == len(open_mission(dive).frames())
    for line in judged:
        assert line["status"] != 0 and line["reason"] == "blurred"
        assert "--sharp-frames" not in line["health"]


def test_a_replay_knows_what_they_showed_when_they_are_gone(tmp_path, dive, sharp, model):
    run(tmp_path, dive, model, "--sharp-frames", sharp, "--log-values")
    shutil.rmtree(sharp)
    said = succeeds("replay", tmp_path / "run.jsonl", "--source", dive, "--bundle", model)
    assert "the same" in said.out + said.err
    assert lines(tmp_path / "run.events.jsonl")[0]["sight"]["sizes"][0]["width"] == 360


@pytest.mark.parametrize("packaged", [False, True])
def test_a_challenger_knows_them_too(tmp_path, dive, sharp, model, packaged):
    shadow = tmp_path / "shadow.jsonl"
    options = (
        "--shadow",
        "waters" if packaged else model,
        "--shadow-log",
        shadow,
        "--sharp-frames",
        sharp,
    )
    found = run(tmp_path, dive, model, *options)
    told = [line["challenger"]["status"] for line in lines(shadow) if "frame" in line]
    assert told.count(0) >= len(found) and -1 not in told
    assert packaged or told.count(0) == len(found) < len(told)


def test_a_store_that_is_called_like_the_packaged_model_is_meant(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "waters").mkdir()
    refuses("waters", model_named, Path("waters"))


def test_limits_of_the_same_size_are_taken_for_those_of_another_camera(dive, sharp, model):
    """What is a little above each of two cameras' limits would pass the higher ones of both."""
    mission = open_mission(sharp)
    measured = measure_sharp_frames(mission)
    known = [replace(measured[0], limits=(99.0,) * 9), *measure_sight(noisy(480, 640))]
    bundle = replace(read_bundle(model), sight=tuple(known)).with_sight(measured)
    assert [one.limits for one in bundle.sight] == [measured[0].limits, known[1].limits]


def test_the_mask_of_the_run_is_that_of_the_sharp_frames(tmp_path, dive, sharp, model):
    def limits(*options):
        run(tmp_path, dive, model, "--sharp-frames", sharp, *options)
        return lines(tmp_path / "run.events.jsonl")[0]["sight"]["sizes"][0]

    whole = limits()
    for path in sharp.glob("*.png"):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        picture[:68] = 0  # a clock's background
        cv2.imwrite(str(path), picture)
    assert limits("--accept-blind")["darkest"] == 0
    masked = limits("--mask", "0,0,1,0.3")
    assert masked["darkest"] == pytest.approx(whole["darkest"], rel=0.2)


def test_frames_of_another_size_than_the_source_s_are_refused(tmp_path, dive, model):
    (tmp_path / "other").mkdir()
    for number, picture in enumerate(noisy(480, 640), 1):
        cv2.imwrite(str(tmp_path / f"other/o_{number}.png"), picture)
    command = "run", "--bundle", model, "--source", dive, "--sharp-frames", tmp_path / "other"
    assert "640x480" in refused("the source's are 360x272", *command)


def test_limits_of_another_camera_do_not_hide_an_obstacle(tmp_path, dive, model):
    """As they do where a camera's own pictures prove that there is nothing but noise."""
    bundle = read_bundle(model)
    strict = replace(bundle.sight[0], limits=(-9.0,) * 9)
    content = replace(bundle.content, sight=(strict,))
    (tmp_path / "strict.tokt").write_bytes(bundle_bytes(content))
    before = len(lines_with_an_obstacle(tmp_path, dive, model))
    assert 0 < before == len(lines_with_an_obstacle(tmp_path, dive, tmp_path / "strict.tokt"))


def lines_with_an_obstacle(tmp_path, dive, model):
    run(tmp_path, dive, model)
    return [line for line in lines(tmp_path / "run.jsonl") if line["status"] == 1]


def test_raw_pixels_are_read_from_gray_frames_alone(sharp, dive):
    gray = measure_sharp_frames(open_mission(sharp))
    raw = measure_sharp_frames(open_mission(sharp), pixel_format="BayerRG8", accept_blind=True)
    assert raw != gray
    for path in sharp.glob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path)))
    colour = measure_sharp_frames(open_mission(sharp), pixel_format="BayerRG8")
    assert colour[0].limits == pytest.approx(gray[0].limits, abs=0.05)


@pytest.mark.parametrize("count", [MAX_FRAMES - 1, MAX_FRAMES + 1, 2 * MAX_FRAMES - 1])
def test_some_frames_are_enough(tmp_path, dive, monkeypatch, count):
    """Twenty, of which the least contrast is told as well."""
    (tmp_path / "some").mkdir()
    for path in sorted((dive / "Left").glob("*.png"))[:count]:
        shutil.copy(path, tmp_path / "some")
    mission, numbers = open_mission(tmp_path / "some"), []
    read = type(mission).read

    def counted(self, frame, camera="left"):
        numbers.append(frame)
        return read(self, frame, camera)

    monkeypatch.setattr(type(mission), "read", counted)
    measure_sharp_frames(mission)
    assert len(set(numbers)) == len(numbers) == min(count, MAX_FRAMES)


def test_sharp_frames_do_for_a_model_whose_own_frames_were_blurred(tmp_path, dive, sharp, model):
    blind = replace(measure_sharp_frames(open_mission(dive))[0], height=1, width=2, blurred=0.1)
    content = replace(read_bundle(model).content, sight=(blind,))
    (tmp_path / "blind.tokt").write_bytes(bundle_bytes(content))
    command = "run", "--bundle", tmp_path / "blind.tokt", "--source", dive
    refused("--accept-blind", *command)
    succeeds(*command, "--sharp-frames", sharp)


def test_frames_that_are_blurred_themselves_are_refused(tmp_path, sharp, model):
    for path in sharp.glob("*.png"):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path), cv2.GaussianBlur(picture, (0, 0), 5))
    command = "run", "--bundle", model, "--source", sharp, "--sharp-frames", sharp
    assert "Name sharper frames" in refused("no finer detail than blurred", *command)
    succeeds(*command, "--accept-blind")


def test_frames_that_are_not_there_or_too_small_are_refused(tmp_path, sharp, model):
    command = "run", "--bundle", model, "--source", sharp, "--sharp-frames"
    refused("nowhere", *command, tmp_path / "nowhere")
    (tmp_path / "small").mkdir()
    cv2.imwrite(str(tmp_path / "small/a_1.png"), cv2.imread(str(next(sharp.glob("*"))))[:9, :9])
    refused("no frame can be read that is large enough", *command, tmp_path / "small")


@pytest.mark.parametrize("sight", ["strict", "loose", "none"])
@pytest.mark.parametrize("name", ["gone", "x" * 300])
def test_a_run_that_its_watchdog_starts_again_warns_without_them_and_clears_nothing(
    tmp_path, dive, model, monkeypatch, name, sight
):
    monkeypatch.setenv(RESTARTS_VARIABLE, "1")
    if sight != "strict":
        loose = measure_sharp_frames(open_mission(dive)) if sight == "loose" else ()
        content = replace(read_bundle(model).content, sight=loose)
        model = tmp_path / "other.tokt"
        model.write_bytes(bundle_bytes(content))
    found = run(tmp_path, dive, model, "--sharp-frames", tmp_path / name)
    judged = lines(tmp_path / "run.jsonl")
    assert {line["status"] for line in found} == {-1} and len(found) < len(judged)
    assert all("--sharp-frames: " in line["health"] for line in judged)
    # A replay judges as that run did.
    monkeypatch.delenv(RESTARTS_VARIABLE)
    said = succeeds("replay", tmp_path / "run.jsonl", "--source", dive, "--bundle", model)
    assert "the same" in said.out + said.err


def test_one_frame_that_cannot_be_read_costs_no_other(dive, sharp):
    whole = measure_sharp_frames(open_mission(sharp))
    first = min(sharp.glob("*.png"))
    shutil.copy(first, sharp / "tiny_L_99.png")
    (sharp / "tiny_L_99.png").write_bytes(first.read_bytes()[:100])
    assert measure_sharp_frames(open_mission(sharp)) == whole


def test_evaluate_takes_them_too(tmp_path, tiny, dive, sharp, model):
    command = "evaluate", model, "--mission", f"tiny={dive}", "--labels", tiny.labels
    command = *command, "--workspace", tmp_path / ".tokt", "--json"

    def unknown(*options):
        return json.loads(succeeds(*command, *options).out)["frames"]["unknown"]

    assert unknown() > unknown("--sharp-frames", sharp) == 0
    other = tmp_path / "other.csv"
    other.write_text(tiny.labels.read_text().replace("tiny,", "other,"))
    both = *command, "--mission", f"other={dive}", "--labels", other, "--sharp-frames", sharp
    refused("goes with one mission", *both)
    refused("go with --mission", "evaluate", model, "--patches", sharp, "--sharp-frames", dive)


def test_the_size_itself_comes_before_a_near_width():
    pictures = [cv2.resize(draw, (360, 300)) for draw in noisy(272, 360)]
    both = measure_sight([*noisy(272, 360), *pictures])
    assert {(one.height, one.width) for one in both} == {(272, 360), (300, 360)}
    for one in both:
        assert limits_for(both, one.height, one.width) is one
    wider = measure_sight([*noisy(272, 360), *noisy(480, 640)])
    assert limits_for(wider, 500, 450) is wider[0] and limits_for(wider, 272, 600) is wider[1]
    assert limits_for((), 1, 1) is None


def test_most_frames_tell_another_camera_or_a_fogged_port(dive, model):
    mission = open_mission(dive)
    assert are_mostly_hidden(read_bundle(model).sight, mission)
    assert not are_mostly_hidden(measure_sharp_frames(mission), mission)


def test_what_needs_no_limits_is_not_said_to_need_frames(dive, model):
    meter = SightMeter(read_bundle(model).sight)
    picture = cv2.imread(str(next((dive / "Left").glob("*.png"))), cv2.IMREAD_GRAYSCALE)
    dark = meter.of(Frame(1, 0.0, picture // 50, None)).fault
    assert dark and "--sharp-frames" not in dark


def test_the_mask_beside_sharp_frames_is_theirs(sharp):
    whole = measure_sharp_frames(open_mission(sharp))
    for path in sharp.glob("*.png"):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        picture[:136, :180] = 90
        cv2.imwrite(str(path), picture)
    flat = measure_sharp_frames(open_mission(sharp), accept_blind=True)
    assert max(flat[0].limits) > max(whole[0].limits) + 1
    write_masks(sharp, CameraMasks(left=ViewMask(((0.0, 0.0, 0.5, 0.5),))))
    masked = measure_sharp_frames(open_mission(sharp))
    assert max(masked[0].limits) < max(whole[0].limits) + 0.5
