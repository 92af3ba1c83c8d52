"""Dataset versions: what their hash covers, what they hold, and what they refuse."""

import hashlib
import json
import os
import shutil
import time
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from tests.calls import refused, refuses, run_python
from tests.fixtures import LABEL_COLUMNS, tower_cells
from tests.inference.test_faults import hold_row
from tokt.features.frames.grid import Grid
from tokt.labels import taxonomy as taxonomy_module
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets import dataset as datasets
from tokt.training.datasets.dataset import (
    DatasetPlan,
    DatasetVersion,
    FrameSource,
    list_datasets,
    open_dataset,
    write_dataset,
)
from tokt.training.datasets.diff import diff_datasets
from tokt.training.datasets.folds import blocked_folds


@pytest.fixture
def build(tmp_path, told):
    """Build a dataset, of the first twelve frames unless asked otherwise, and give its JSON."""

    def run(*arguments, name="tiny", block=4, frames="1-12"):
        where = ("--block", block, "--workspace", tmp_path / "ws")
        some = ("--frames", frames) if frames else ()
        return told("dataset", "build", name, *where, *some, *arguments)

    return run


@pytest.fixture(scope="module")
def twelve(tiny, told, tmp_path_factory):
    """The dataset of the first twelve frames."""
    workspace = tmp_path_factory.mktemp("twelve")
    some = ("--frames", "1-12", "--block", 4, "--workspace", workspace)
    told("dataset", "build", "tiny", *inputs(tiny), *some)
    return open_dataset("tiny", workspace / "datasets")


@pytest.fixture
def fabricate_plan():
    """Two frames of one patch of a dive, planned anew each time."""

    def load(number):
        return cv2.imencode(".png", np.full((6, 6), 40 * number, np.uint8))[1].tobytes(), ".png"

    def plan(**more):
        frames = [FrameSource("dive", "left", n, f"dive#{n}", partial(load, n)) for n in (1, 2)]
        rows = [["dive", "left", 1, 0, 0, "ocean"], ["dive", "left", 2, 0, 0, "reef"]]
        patches = pd.DataFrame(rows, columns=LABEL_COLUMNS)
        about = (Grid(1, 1, None), Taxonomy.load(), frames, patches, 0, 1, ["by hand"])
        return DatasetPlan("placed", "binary", *about, **more)

    return plan


def inputs(mission, labels=None):
    return "--mission", mission.path, "--labels", labels or mission.labels


@pytest.mark.process
def test_same_inputs_same_hash_in_another_process_and_workspace(tiny, trained, tmp_path):
    command = ("dataset", "build", "other-name", "--json", "--block", 4, *inputs(tiny))
    ran = run_python("-m", "tokt", *command, "--workspace", tmp_path)
    assert json.loads(ran.stdout)["hash"] == open_dataset("tiny", trained / "datasets").hash


def test_building_twice_writes_once(build, tiny, tmp_path):
    first = build(*inputs(tiny))
    folder = tmp_path / "ws" / "datasets" / "tiny" / first["hash"][:16]
    stamps = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert build(*inputs(tiny)) == first
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == stamps


def test_order_of_label_rows_and_folder_name_do_not_matter(
    build, twelve, own_tiny, tiny_truth, tmp_path
):
    rows = tiny_truth.labels()
    np.random.default_rng(1).shuffle(rows)
    shuffled = tiny_truth.write_labels(tmp_path / "shuffled.csv", rows)
    moved = own_tiny.path.rename(tmp_path / "elsewhere")
    assert build("--mission", moved, "--labels", shuffled)["hash"] == twelve.hash


def test_other_compression_of_the_same_pixels_does_not_matter(build, twelve, own_tiny):
    for path in (own_tiny.path / "Left").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert build(*inputs(own_tiny))["hash"] == twelve.hash


def change_pixel(mission, build, truth, tmp_path):
    path = mission.path / "Left" / "tiny_L_7.png"
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    image[100, 100] ^= 1
    cv2.imwrite(str(path), image)
    return build(*inputs(mission))


def change_label(mission, build, truth, tmp_path):
    rows = truth.labels()
    rows[5][-1] = "reef"
    return build(*inputs(mission, truth.write_labels(tmp_path / "l.csv", rows)))


def harmless_sand(folder):
    """The packaged taxonomy, but for sand, which is no obstacle here."""
    text = Path(taxonomy_module.__file__).with_name("taxonomy.toml").read_text("utf-8")
    before, after = text.split('name = "sand"')
    file = folder / "taxonomy.toml"
    file.write_text(before + 'name = "sand"' + after.replace("true", "false", 1), "utf-8")
    return file


def change_flag(mission, build, truth, tmp_path):
    return build(*inputs(mission), "--taxonomy", harmless_sand(tmp_path))


def change_grid(mission, build, truth, tmp_path):
    rows = [row for row in truth.labels() if row[3] < 9]
    labels = truth.write_labels(tmp_path / "l.csv", rows)
    return build(*inputs(mission, labels), "--grid", "9x10@360")


@pytest.mark.parametrize(
    ("change", "settings", "of_mission"),
    [
        (change_pixel, set(), {"frames_with_other_pixels": 1}),
        (change_label, set(), {"patches_relabelled": 1}),
        (change_flag, {"class sand"}, None),
        (change_grid, {"grid"}, None),
        (lambda mission, build, *_: build(*inputs(mission), "--task", "classes"), {"task"}, None),
        (
            lambda mission, build, *_: build(*inputs(mission), block=5),
            {"block_frames"},
            {"frames_regrouped": 4},
        ),
        (
            lambda mission, build, *_: build(*inputs(mission), frames="1-11"),
            set(),
            {"frames_gone": 1, "patches_gone": 100},
        ),
    ],
    ids=["pixel", "label", "obstacle flag", "grid", "task", "block", "frames"],
)
def test_what_can_change_a_model_changes_the_hash(
    change, settings, of_mission, own_tiny, build, tiny_truth, tmp_path, twelve
):
    assert change(own_tiny, build, tiny_truth, tmp_path)["hash"] != twelve.hash
    found = diff_datasets(twelve, open_dataset("tiny", tmp_path / "ws" / "datasets"))
    assert not found["same_content"] and set(found["settings"]) == settings
    assert found["missions"] == {
        "added": [],
        "gone": [],
        "changes": {} if of_mission is None else {"tiny": of_mission},
    }


def test_diff_says_what_changed_between_two_versions(
    build, tiny, tiny_truth, twelve, two_dives, tmp_path, told, done, refused
):
    first = build(*inputs(tiny), frames=None)
    rows = [row for row in tiny_truth.labels() if row[2] != 40]
    rows[5][-1] = "reef"
    dive = two_dives / "2017" / "frames"
    labels = ("--labels", tiny_truth.write_labels(tmp_path / "l.csv", rows))
    more = ("--mission", f"dive-2017={dive}", "--labels", two_dives / "2017.csv")
    second = build("--mission", tiny.path, *labels, *more, frames=None)
    words = ("dataset", "diff", first["label"], "tiny", "--workspace", tmp_path / "ws")
    found = told(*words)
    assert (found["before"], found["after"]) == (first["label"], second["label"])
    assert found["frames"] == [40, 51] and not found["settings"] and not found["same_content"]
    gone = 98 if tower_cells(40) else 100
    assert found["missions"] == {
        "added": ["dive-2017"],
        "gone": [],
        "changes": {
            "dive-2017": {"frames_added": 12, "patches_added": len(twelve.patches)},
            "tiny": {"frames_gone": 1, "patches_gone": gone, "patches_relabelled": 1},
        },
    }
    assert found["relabelled"] == [{"from": "ocean", "to": "reef", "patches": 1}]
    assert found["sources"]["gone"] == [first["sources"][-1]]
    assert found["sources"]["added"] == ["mission dive-2017", second["sources"][-1]]
    said = done(*words).out
    assert "from ocean to reef: 1" in said and "mission dive-2017: 12 frames added" in said
    # A table that is not what the hash was taken of tells of nothing.
    folder = open_dataset("tiny", tmp_path / "ws" / "datasets").path
    patches = pd.read_parquet(folder / "patches.parquet").assign(label="ocean")
    patches.to_parquet(folder / "patches.parquet", index=False)
    refused("has been changed on disk", *words)


def test_unsure_is_counted_and_never_stored(trained, tiny_truth, told):
    info = told("dataset", "show", "tiny", "--workspace", trained)
    rows = tiny_truth.labels()
    unsure = sum(row[-1] == "unsure" for row in rows)
    patches = open_dataset("tiny", trained / "datasets").patches
    assert unsure > 0
    assert info["unsure_left_out"] == unsure
    assert len(patches) == info["patches"] == len(rows) - unsure
    assert set(patches.label) == {"ocean", "subsea_installation"}


def test_plain_pandas_reads_the_tables(trained):
    (folder,) = (trained / "datasets" / "tiny").glob("*/")
    patches = pd.read_parquet(folder / "patches.parquet")
    frames = pd.read_parquet(folder / "frames.parquet")
    names = ("mission", "camera", "frame", "row", "col", "label", "group", "position")
    assert tuple(patches) == names
    assert len(frames) == 40
    assert set(frames.file) == {path.name for path in (folder / "frames").iterdir()}
    joined = patches.merge(frames, on=["mission", "camera", "frame"], suffixes=("", "_of_frame"))
    assert (joined.group == joined.group_of_frame).all()


def test_levels_of_12_bits_in_16_are_not_learnt_from(own_tiny, tmp_path, done):
    *others, last = sorted((own_tiny.path / "Left").iterdir())
    mission, labels = ("--mission", own_tiny.path), ("--labels", own_tiny.labels)
    build = ("dataset", "build", "d", *mission, *labels, "--workspace", tmp_path / "w")
    words = "its 16-bit pixels leave the upper bits empty, and would be nearly black"
    assert cv2.imwrite(str(last), cv2.imread(str(last)).astype(np.uint16) * 16)
    ran = done(*build)
    assert "1 frame left out, damaged or unreadable" in ran.err and words in ran.err
    assert json.loads(done("dataset", "show", "d", *build[-2:], "--json").out)["frames"] == 39
    for frame in others:
        assert cv2.imwrite(str(frame), cv2.imread(str(frame)).astype(np.uint16) * 16)
    said = refused(words, *build)
    assert "; convert it to 8 bits, all files alike" in said and "39 more of 40 frames" in said
    hold_row(
        "12-bit levels in a 16-bit image, to be learnt from",
        "the frame is left out and listed; where most are so, code 2 with the remedy",
        "nothing",
    )


def test_annotators_in_conflict_are_left_out_with_a_note(tiny, tiny_truth, tmp_path, done):
    rows = [row for row in tiny_truth.labels() if row[2] in (8, 9)]
    second = [[*row[:-1], "ocean"] for row in rows if row[-1] == "subsea_installation"]
    extra = tiny_truth.write_labels(tmp_path / "second.csv", second)
    where = ("--labels", extra, "--json", "--workspace", tmp_path / "ws")
    ran = done("dataset", "build", "two", *inputs(tiny), *where)
    info = json.loads(ran.out)
    assert f"note: {len(second)} patches left out: annotators disagree" in ran.err
    assert info["labels"]["subsea_installation"] == 200 - len(second)
    assert info["unsure_left_out"] == 50 + len(second)


def test_name_hash_prefix_and_latest(build, tiny, tmp_path):
    old = build(*inputs(tiny))["hash"]
    new = build(*inputs(tiny), block=5)["hash"]
    root = tmp_path / "ws" / "datasets"
    assert open_dataset("tiny", root).hash == new
    assert open_dataset(f"tiny@{old[:6]}", root).hash == old
    assert open_dataset(f"tiny@{old}", root).hash == old
    assert {item.hash for item in list_datasets(root)} == {old, new}
    build(*inputs(tiny))
    assert open_dataset("tiny", root).hash == old
    for reference in ("tiny@0000000000", "tiny@.", "nothing", "nothing@12"):
        refuses("", open_dataset, reference, root)


def test_only_whole_versions_are_listed(build, tiny, tmp_path):
    info = build(*inputs(tiny))
    root = tmp_path / "ws" / "datasets"
    whole = root / "tiny" / info["hash"][:16]
    # What a build leaves that was killed at its last moment, here or in an older layout.
    shutil.copytree(whole, root / ".partial-0123456789ab-tiny")
    shutil.copytree(whole, root / "tiny" / ".partial-0123456789ab-building")
    assert [item.path for item in list_datasets(root)] == [whole]
    refuses(r"there are: tiny\)", open_dataset, "nothing", root)


def test_building_removes_what_was_abandoned_but_not_what_is_being_written(build, tiny, tmp_path):
    root = tmp_path / "ws" / "datasets"
    old, young = root / ".partial-aaa-tiny", root / ".partial-bbb-tiny"
    for folder in (old, young):
        (folder / "frames").mkdir(parents=True)
    long_ago = time.time() - 3 * 24 * 3600
    os.utime(old, (long_ago, long_ago))
    build(*inputs(tiny))
    assert not old.exists()
    assert young.is_dir()


def test_a_refused_build_leaves_nothing(own_tiny, tmp_path, refused):
    for frame in (own_tiny.path / "Left").iterdir():
        frame.write_bytes(b"not an image")
    refused(
        "not an image", "dataset", "build", "x", *inputs(own_tiny), "--workspace", tmp_path / "ws"
    )
    assert list((tmp_path / "ws" / "datasets").iterdir()) == []


@pytest.fixture
def stored(workspace):
    """The folder of a dataset that a test may damage, in a workspace without feature cache."""
    shutil.rmtree(workspace / "cache")
    return open_dataset("tiny", workspace / "datasets").path


def training_on(stored):
    where = ("--folds", 3, "--embargo", 1, "--workspace", stored.parents[2])
    return "train", "tiny", "--extractor", "lbp", *where


def test_a_changed_frame_is_detected_at_training(stored, refused):
    path = sorted((stored / "frames").iterdir())[5]
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    image[0, 0] ^= 1
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    refused("has changed", *training_on(stored))


def test_a_changed_label_is_detected_at_training(stored, refused):
    patches = pd.read_parquet(stored / "patches.parquet")
    patches.loc[0, "label"] = "subsea_installation"
    patches.to_parquet(stored / "patches.parquet", index=False)
    refused("changed on disk", *training_on(stored))


@pytest.mark.parametrize("name", ["dataset.json", "patches.parquet", "frames.parquet"])
@pytest.mark.parametrize("how", ["truncated", "gone"])
def test_a_damaged_file_is_one_clear_line(stored, name, how, refused):
    path = stored / name
    data = path.read_bytes()
    path.unlink()
    if how == "truncated":
        path.write_bytes(data[: len(data) // 2])
    refused("damaged", *training_on(stored))


@pytest.fixture
def format_1(tmp_path):
    """A dataset folder as format 1 has it, written without any code of tokt."""
    root = tmp_path / "datasets"
    folder = root / "old" / "placeholder"
    (folder / "frames").mkdir(parents=True)
    rows, frames = [], []
    for number in (1, 2):
        pixels = np.full((6, 6), 40 * number, np.uint8)
        digest = hashlib.sha256(b"(6, 6)" + pixels.tobytes()).hexdigest()
        cv2.imwrite(str(folder / "frames" / f"{digest}.png"), pixels)
        group = f"dive#{number:05d}"
        frames.append(["dive", "left", number, group, digest, f"{digest}.png", 6, 6])
        rows.append(["dive", "left", number, 0, 0, ["ocean", "reef"][number - 1], group])
    frame_columns = ["mission", "camera", "frame", "group", "digest", "file", "height", "width"]
    patch_table = pd.DataFrame(rows, columns=[*LABEL_COLUMNS, "group"])
    frame_table = pd.DataFrame(frames, columns=frame_columns)
    patch_table.to_parquet(folder / "patches.parquet", index=False)
    frame_table.to_parquet(folder / "frames.parquet", index=False)
    classes = [
        {"name": name, "obstacle": obstacle, "color": "#000000", "key": name[0], "description": ""}
        for name, obstacle in (("ocean", False), ("reef", True))
    ]
    header = {
        **{"format_version": 1, "task": "binary", "block_frames": 1},
        "grid": {"rows": 1, "cols": 1, "width": None},
        "taxonomy": {"format": 1, "classes": classes},
    }
    text = json.dumps(header, sort_keys=True, separators=(",", ":"))
    text += patch_table.to_csv(index=False, lineterminator="\n")
    text += frame_table[frame_columns[:5]].to_csv(index=False, lineterminator="\n")
    digest = hashlib.sha256(text.encode()).hexdigest()
    counts = {"patches": 2, "frames": 2, "groups": 2, "labels": {"ocean": 1, "reef": 1}}
    about = {"name": "old", "unsure_left_out": 0, "sources": ["by hand"], "hash": digest}
    (folder / "dataset.json").write_text(json.dumps({**header, **about, **counts}), "utf-8")
    folder.rename(folder.parent / digest[:16])
    (root / "old" / "latest").write_text(digest[:16] + "\n", "utf-8")
    return root


def test_a_format_1_dataset_opens(format_1, monkeypatch):
    dataset = open_dataset("old", format_1)
    dataset.check()
    monkeypatch.setattr(datasets, "_HASHED_AT_ONCE", 1)  # as a large one is hashed, in parts
    dataset.check()
    assert dataset.targets().tolist() == [0, 1]
    assert dataset.classes() == ("clear", "obstacle")
    assert (dataset.read_frame(1) == 80).all()
    assert dataset.grid == Grid(1, 1, None)
    assert dataset.sites == {}
    # Blocks and gaps mean what they meant: they count the numbers.
    assert not dataset.has_positions
    assert dataset.patches.position.tolist() == dataset.frames.position.tolist() == [1, 2]


def test_a_newer_format_is_refused(format_1):
    path = open_dataset("old", format_1).path / "dataset.json"
    path.write_text(path.read_text("utf-8").replace('"format_version": 1', '"format_version": 3'))
    refuses("newer than this tokt reads", open_dataset, "old", format_1)


def test_a_patch_folder_is_ungrouped_and_its_figures_say_so(cut, done, told, refused):
    where = ("--workspace", cut.workspace)
    info = told("dataset", "show", "cut", *where)
    assert "UNGROUPED" in cut.built and info["block_frames"] is None
    assert (info["patches"], info["unsure_left_out"]) == (40, 20)
    moving = ("train", "cut", "--preset", "water", "--fixed-boundary", *where)
    refused("with a folder of patches it is fixed anyway", *moving)
    assert "UNGROUPED" in cut.trained and "in a row" not in cut.trained  # patches are no frames
    # With the default embargo: file numbers are no frame numbers, so it must not bite.
    metrics = told("models", "show", "cut-lbp", *where)["metrics"]
    assert metrics["split"].startswith("UNGROUPED") and metrics["patches_tested"] == 40
    assert metrics["patch"]["f1"] > 0.7
    assert "UNGROUPED" in done("models", "show", "cut-lbp", *where).out


def test_a_folder_that_is_no_class_is_refused(cut_patches, tmp_path, refused):
    folder = cut_patches(tmp_path / "cut", 3, 1)
    (folder / "reef").rename(folder / "coral")
    command = ("dataset", "build", "cut", "--patches", folder, "--workspace", tmp_path)
    said = refused("unknown class 'coral'", *command)
    assert "append a [[classes]] table to taxonomy.toml in the workspace" in said


def test_a_class_in_few_places_is_warned_of_when_built(tiny, tiny_truth, tmp_path, done):
    rows = tiny_truth.labels()
    for row in rows:
        if row[3] == 9:
            row[5] = {5: "reef", 9: "sand", 13: "sand"}.get(row[2], row[5])
    labels = tiny_truth.write_labels(tmp_path / "few.csv", rows)
    where = ("--labels", labels, "--task", "classes", "--block", 4, "--workspace", tmp_path)
    ran = done("dataset", "build", "few", "--mission", tiny.path, *where)
    assert [line for line in ran.err.splitlines() if line.startswith("WARNING")] == [
        "WARNING: training takes 6 labelled frames or more, and each class in 3 blocks of them; "
        "there are 40 labelled frames. Label 2 more, 1 with sand and 2 with reef. A block is 4 "
        "frames that follow each other: near copies, which count as one. If they are single "
        "photographs, give tokt dataset build --block 1"
    ]


def test_one_mission_cannot_be_given_twice(tiny, tmp_path, refused):
    twice = (*inputs(tiny), "--mission", tiny.path, "--workspace", tmp_path)
    refused("two missions are named 'tiny'", "dataset", "build", "x", *twice)


@pytest.fixture
def two_dives(tiny_dive, tiny_truth, tmp_path):
    """Two dives whose folders have one name, each with a label file that names it otherwise."""
    for year, gain in ((2016, 1.0), (2017, 1.1)):
        tiny_dive(tmp_path / str(year) / "frames", range(1, 13), gain)
        rows = [row for row in tiny_truth.labels(f"dive-{year}") if row[2] <= 12]
        tiny_truth.write_labels(tmp_path / f"{year}.csv", rows)
    return tmp_path


def test_missions_are_named_as_their_labels_call_them(build, two_dives, tmp_path, refused):
    folders = [two_dives / f"{year}" / "frames" for year in (2016, 2017)]
    labels = [part for year in (2016, 2017) for part in ("--labels", two_dives / f"{year}.csv")]
    plain = [part for folder in folders for part in ("--mission", folder)]
    space = ("--workspace", tmp_path / "ws")
    refused("give NAME=DIR", "dataset", "build", "x", *plain, *labels, *space)
    (two_dives / "second").symlink_to(folders[1])
    named = ("--mission", f"dive-2016={folders[0]}", "--mission", f"dive-2017={two_dives}/second")
    info = build(*named, *labels, frames=None)
    assert info["sources"][:2] == ["mission dive-2016", "mission dive-2017"]
    frames = open_dataset("tiny", tmp_path / "ws" / "datasets").frames
    assert frames.mission.value_counts().to_dict() == {"dive-2016": 12, "dive-2017": 12}
    assert set(frames.group.str.partition("#")[0]) == {"dive-2016", "dive-2017"}


def test_sites_are_kept_beside_the_content_also_where_they_become_known_later(
    fabricate_plan, tmp_path, no_progress
):
    root = tmp_path / "datasets"
    plain = write_dataset(fabricate_plan(), root, no_progress)
    assert "sites" not in plain.info
    for sites in ({"dive": "fjord"}, {}):
        again = write_dataset(fabricate_plan(sites=sites), root, no_progress)
        assert again.hash == plain.hash
        assert open_dataset("placed", root).sites == {"dive": "fjord"}
    again.check()
    file = again.path / "dataset.json"
    file.write_text(file.read_text("utf-8").replace('{\n    "dive": "fjord"\n  }', "7"), "utf-8")
    refuses("is damaged", DatasetVersion, again.path)


def test_copies_of_a_frame_stay_on_one_side(tiny_dive, tmp_path, done):
    """A renamed copy of a dive would otherwise put each test frame into the training part."""
    missions = []
    for name in ("dive", "twin"):
        labels = tiny_dive(tmp_path / name, range(1, 21))
        missions += ["--mission", tmp_path / name, "--labels", labels]
    where = ("--block", 4, "--workspace", tmp_path / "ws", "--json")
    assert "20 frames are copies" in done("dataset", "build", "both", *missions, *where).err
    dataset = open_dataset("both", tmp_path / "ws" / "datasets")
    assert dataset.patches.groupby(["frame"]).group.nunique().max() == 1
    digests = dataset.patches.merge(dataset.frames, on=["mission", "camera", "frame"]).digest
    for fold in blocked_folds(dataset.patches, dataset.targets(), 2, 1):
        assert not set(digests.iloc[fold.train]) & set(digests.iloc[fold.test])


def test_labels_in_the_store_are_never_taken_for_another_dive(own_tiny, tmp_path, done, refused):
    space = ("--workspace", tmp_path / "ws")
    done("labels", "import", own_tiny.labels, *space)
    space = (*space, "--frames", "1-12")
    other = tmp_path / "other-dive"
    shutil.copytree(own_tiny.path, other)
    command = ("dataset", "build", "d", "--mission", other, *space)
    refused("no labels for mission 'other-dive'", *command)
    assert "are taken for the frames in" in done(*command, "--labels", own_tiny.labels).err
    done("dataset", "build", "d", "--mission", f"tiny={other}", *space)  # a person says so


def test_a_dataset_whose_classes_are_all_clear_is_refused(own_tiny, tmp_path, refused):
    text = own_tiny.labels.read_text().replace("subsea_installation", "sand")
    labels = tmp_path / "l.csv"
    labels.write_text(text)
    asked = ("--taxonomy", harmless_sand(tmp_path), "--workspace", tmp_path / "ws")
    command = ("dataset", "build", "d", *inputs(own_tiny, labels), "--task", "classes")
    refused("could never warn", *command, *asked)


def half_written(picture, name):
    """A picture whose file ends in its middle, with the end that a camera or a repair gives it."""
    data = cv2.imencode(".jpg", picture)[1].tobytes()
    name.write_bytes(data[: len(data) // 2] + b"\xff\xd9")


def test_half_written_pictures_are_left_out_and_listed(own_tiny, tmp_path, done):
    for number in (7, 8):
        frame = own_tiny.path / "Left" / f"tiny_L_{number}.png"
        half_written(cv2.imread(str(frame)), frame.with_suffix(".jpg"))
        frame.unlink()
    build = ("dataset", "build", "d", *inputs(own_tiny), "--workspace", tmp_path / "w")
    assert "2 frames left out, damaged or unreadable: tiny, left frame 7: flat" in done(*build).err
    dataset = open_dataset("d", tmp_path / "w" / "datasets")
    assert not {7, 8} & set(dataset.frames.frame) and len(dataset.frames) == 38
    assert not {7, 8} & set(dataset.patches.frame)
    assert len(list((dataset.path / "frames").iterdir())) == 38


def test_a_patch_folder_says_what_it_passed_over_and_contradicts(tmp_path, done):
    rng = np.random.default_rng(4)
    pictures = rng.integers(0, 255, (24, 64, 64), np.uint8)
    for name, some in (("ocean", pictures[:12]), ("sand", pictures[12:])):
        (tmp_path / "p" / name / "more").mkdir(parents=True)
        for n, picture in enumerate(some):
            cv2.imwrite(str(tmp_path / "p" / name / f"{n}.{'webp' if n % 2 else 'png'}"), picture)
    cv2.imwrite(str(tmp_path / "p" / "sand" / "more" / "1.png"), pictures[0])
    (tmp_path / "p" / "sand" / "9.dng").write_bytes(b"II*")
    cv2.imwrite(str(tmp_path / "p" / "sand" / "same.png"), pictures[0])
    half_written(pictures[20], tmp_path / "p" / "sand" / "half.jpg")
    (tmp_path / "p" / "sand" / "broken.jpg").write_bytes(b"\xff\xd8\xff")
    (tmp_path / "p" / ".cache").mkdir()
    cv2.imwrite(str(tmp_path / "p" / ".cache" / "1.png"), pictures[0])
    ran = done("dataset", "build", "d", "--patches", tmp_path / "p", "--workspace", tmp_path / "w")
    for words in (
        "1 picture passed over, in folders of folders",
        "1 picture passed over, .dng: a kind of picture that tokt does not read",
        "2 frames left out, damaged or unreadable: sand/broken.jpg: the JPEG is truncated",
        "sand/half.jpg: flat",
        "2 patches left out: the very same picture is labelled as two classes",
    ):
        assert words in ran.err
    dataset = open_dataset("d", tmp_path / "w" / "datasets")
    assert dataset.patches.label.value_counts().to_dict() == {"ocean": 11, "sand": 12}
