"""A label of another tool's file is on its own frame and patch, or left out and counted."""

import csv
import io
import json
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image

from tests.calls import refuses
from tests.fixtures import write_video
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.boxes import Size
from tokt.labels.formats.formats import FORMATS
from tokt.labels.formats.images import FrameKey, MissionImages
from tokt.labels.formats.options import ReadOptions
from tokt.labels.labels import Labels
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import Taxonomy

from .examples import SLOW, TAXONOMY, put, told

SIZES = {1: Size(120, 160), 2: Size(90, 160), 3: Size(160, 120)}  # the last one is turned by Exif
CAMERAS_SIZE = {**SIZES, 3: Size(120, 160)}  # of the pictures as the camera stored them
GRID = Grid(4, 4, None)


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """A flat mission whose frames differ in size; one of them was taken with the camera turned."""
    folder = tmp_path_factory.mktemp("stranger") / "dive_1"
    folder.mkdir()
    rng = np.random.default_rng(1)
    for number, size in CAMERAS_SIZE.items():
        image = rng.integers(40, 90, (*size, 3), np.uint8)
        cv2.imwrite(str(folder / f"frame_{number}.jpg"), image)
    exif = Image.Exif()
    exif[0x112] = 6
    with Image.open(folder / "frame_3.jpg") as picture:
        picture.save(folder / "frame_3.jpg", exif=exif)
    return MissionImages(open_mission(folder))


def test_sizes_by_the_header_are_those_of_the_decoded_pictures(dive, tmp_path):
    rng = np.random.default_rng(2)
    for orientation in range(1, 9):
        for ending in ("jpg", "png"):
            exif = Image.Exif()
            exif[0x112] = orientation
            picture = Image.fromarray(rng.integers(0, 255, (30, 50, 3), np.uint8))
            picture.save(
                tmp_path / f"{ending}_{orientation}{ending == 'png':d}.{ending}", exif=exif
            )
    for ending in ("bmp", "tif", "ppm"):
        number = {"bmp": 101, "tif": 102, "ppm": 103}[ending]
        cv2.imwrite(
            str(tmp_path / f"x_{number}.{ending}"), rng.integers(0, 255, (30, 50), np.uint8)
        )
    for images in (dive, MissionImages(open_mission(tmp_path))):
        for number in images.mission.frames():
            key = FrameKey("left", number)
            assert images.size(key) == images.pixels(key).shape[:2], images.file_name(key)


@dataclass(frozen=True)
class Said:
    """One box of a stranger's file: a patch of a frame, said in a picture of some size."""

    frame: int
    row: int
    col: int
    label: str
    folder: str
    scale: float
    as_stored: bool
    turned: float
    verified: bool

    @property
    def image(self):
        return f"{self.folder}frame_{self.frame}.jpg"

    @property
    def size(self):
        size = (CAMERAS_SIZE if self.as_stored else SIZES)[self.frame]
        return Size(round(size.height * self.scale), round(size.width * self.scale))

    @property
    def sides(self):
        """The patch's width and height in pixels of the picture of that size."""
        return self.size.width / GRID.cols, self.size.height / GRID.rows

    @property
    def corner(self):
        """The patch's upper left corner, x and y."""
        return self.col * self.sides[0], self.row * self.sides[1]

    @property
    def box(self):
        (x, y), (width, height) = self.corner, self.sides
        return x, y, x + width, y + height

    @property
    def is_right(self):
        here = self.folder in ("", "dive_1/", "a/dive_1/", "C:\\x\\dive_1\\", "images/")
        return here and not self.turned and self.size.is_like(SIZES[self.frame])


FOLDERS = ("", "dive_1/", "a/dive_1/", "C:\\x\\dive_1\\", "images/", "dive_2/", "dive_2/images/")
SAID = st.builds(
    Said,
    st.sampled_from([1, 2, 3]),
    st.integers(0, 3),
    st.integers(0, 3),
    st.sampled_from(["ocean", "other"]),
    st.sampled_from(FOLDERS),
    st.sampled_from([1, 0.5, 2, 2.5]),
    st.booleans(),
    st.sampled_from([0, 0, 0, 90.0]),
    st.booleans(),
)


def _coco(boxes):
    images = list(dict.fromkeys((said.image, said.size) for said in boxes))
    ids = {image: n for n, image in enumerate(images, 1)}
    names = ("ocean", "other")
    return json.dumps(
        {
            "images": [
                {"id": n, "file_name": name, "width": size.width, "height": size.height}
                for (name, size), n in ids.items()
            ],
            "categories": [{"id": n, "name": name} for n, name in enumerate(names)],
            "annotations": [
                {
                    "id": n,
                    "image_id": ids[said.image, said.size],
                    "category_id": names.index(said.label),
                    "bbox": [*said.corner, *said.sides],
                    "attributes": {"rotation": said.turned, "verified": said.verified},
                }
                for n, said in enumerate(boxes)
            ],
        }
    )


def _label_studio(boxes):
    def result(said):
        x0, y0, x1, y1 = said.box
        across, down = 100 / said.size.width, 100 / said.size.height
        place = {"x": x0 * across, "y": y0 * down}
        place |= {"width": (x1 - x0) * across, "height": (y1 - y0) * down}
        return {
            "type": "rectanglelabels",
            "original_width": said.size.width,
            "original_height": said.size.height,
            "value": {**place, "rotation": said.turned, "rectanglelabels": [said.label]},
            "meta": {"verified": said.verified},
        }

    tasks = {}
    for said in boxes:
        tasks.setdefault(said.image, []).append(result(said))
    return json.dumps(
        [
            {"data": {"image": name}, "annotations": [{"result": results}]}
            for name, results in tasks.items()
        ]
    )


def _cvat(boxes):
    text = "<annotations>"
    for name, size in dict.fromkeys((said.image, said.size) for said in boxes):
        text += f'<image name="{name}" width="{size.width}" height="{size.height}">'
        for said in boxes:
            if (said.image, said.size) == (name, size):
                x0, y0, x1, y1 = said.box
                text += f'<box label="{said.label}" xtl="{x0}" ytl="{y0}" xbr="{x1}" ybr="{y1}"'
                text += f' rotation="{said.turned}"><attribute name="verified">{said.verified}'
                text += "</attribute></box>"
        text += "</image>"
    return text + "</annotations>"


WRITERS = {"coco": (_coco, "json"), "labelstudio": (_label_studio, "json"), "cvat": (_cvat, "xml")}


@pytest.mark.parametrize("name", WRITERS)
@SLOW
@given(st.lists(SAID, min_size=1, max_size=8))
def test_a_box_is_on_its_frame_and_patch_or_left_out_and_counted(
    tmp_path_factory, dive, name, boxes
):
    write, ending = WRITERS[name]
    path = put(tmp_path_factory.mktemp("boxes"), write(boxes), f"boxes.{ending}")
    options = ReadOptions(TAXONOMY, annotator="eva", grid=GRID, images=dive)
    right = [said for said in boxes if said.is_right]
    try:
        read = FORMATS[name].read(path, options)
    except ToktError as error:
        names = {said.frame: set() for said in boxes}
        for said in boxes:
            if said.folder[:6] != "dive_2":
                names[said.frame].add((said.image, said.size))
        doubled = any(len(each) > 1 for each in names.values())
        assert not right or (doubled and "are both left frame" in str(error))
        return
    told = {(said.frame, said.row, said.col, said.verified) for said in right}
    sources = {True: "human", False: "model"}
    assert {(record.frame, record.row, record.col, record.source) for record in read.records} == {
        (*place, sources[verified]) for *place, verified in told
    }
    for record in read.records:
        assert record.mission == "dive_1" and record.label in {
            said.label
            for said in right
            if (said.frame, said.row, said.col) == (record.frame, record.row, record.col)
        }
    lost = sum(int(line.split()[0]) for line in read.lost if "left out: " in line)
    assert lost == len(boxes) - len(right)


ROWS = st.lists(
    st.tuples(st.integers(1, 3), st.integers(0, 3), st.integers(0, 3), st.integers(0, 4)),
    min_size=1,
    max_size=9,
    unique_by=lambda row: row[:3],
)


@SLOW
@given(ROWS)
@example([(1, 0, 0, 0), (1, 0, 1, 1)])
def test_one_odd_row_costs_one_row(tmp_path_factory, dive, rows):
    """Rows of the last number are odd: they alone are lost, unless they are most of the file."""
    odd = ["9", "x", "", "0.5"]
    text = "mission,camera,frame,row,col,label\n" + "".join(
        f"dive_1,left,{frame},{row},{odd[kind] if kind < 4 else col},ocean\n"
        for frame, row, col, kind in rows
    )
    path = put(tmp_path_factory.mktemp("rows"), text, "rows.csv")
    right = {(frame, row, col) for frame, row, col, kind in rows if kind == 4}
    lost = len(rows) - len(right)
    options = ReadOptions(TAXONOMY, grid=GRID, images=dive)
    if 2 * lost > len(rows):
        assert "line " in refuses("", FORMATS["csv"].read, path, options)
        return
    read = FORMATS["csv"].read(path, options)
    assert {(record.frame, record.row, record.col) for record in read.records} == right
    assert not lost or read.lost[-1].split(" left out")[0] in ("1 entry", f"{lost} entries")


def test_what_a_row_says_twice_and_otherwise_does_not_count(tmp_path, dive):
    rows = ["dive_1,left,1,0,0,ocean", "dive_1,left,1,0,1,ocean", "dive_1,left,1,0,0,other"]
    text = "\n".join(["mission,camera,frame,row,col,label,depth", *(f"{row},3" for row in rows)])
    read = FORMATS["csv"].read(put(tmp_path, text, "a.csv"), ReadOptions(TAXONOMY))
    assert [(record.row, record.col) for record in read.records] == [(0, 1)]
    assert (
        "line 4: dive_1 left frame 1 row 0 col 0 (10x10@360) is labelled on line 2" in read.lost[0]
    )
    assert read.lost[1] == "fields that tokt does not read: depth"


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Forty frames, ten a second."""
    frames = (np.full((48, 64, 3), 5 * level, np.uint8) for level in range(40))
    return MissionImages(open_mission(write_video(tmp_path_factory.mktemp("v") / "v.avi", frames)))


@SLOW
@given(st.sampled_from([1, 2.5, 5, 12.5, 25, 50]), st.integers(0, 39), st.booleans())
def test_time_decides_which_frame_of_a_video(tmp_path_factory, video, rate, number, by_clock):
    """The frame's number counts at the file's rate, whatever the video has."""
    seconds = number / rate
    clock = f"00:00:{seconds:09.6f}" if by_clock else ""
    text = f"# metadata,fps: {rate}\n0,{clock},{number},0,0,64,48,1,-1,ocean,1\n"
    path = put(tmp_path_factory.mktemp("rate"), text, "v.csv")
    options = ReadOptions(TAXONOMY, grid=Grid(2, 2, None), images=video)
    frame = round(seconds * video.frames_per_second) + 1
    if frame > 40:
        refuses("not of the mission", FORMATS["viame"].read, path, options)
    else:
        assert {r.frame for r in FORMATS["viame"].read(path, options).records} == {frame}


def test_an_export_of_a_video_says_its_rate(tmp_path, video):
    text = "0,,7,0,0,64,48,1,-1,ocean,1\n"
    options = ReadOptions(TAXONOMY, grid=Grid(2, 2, None), images=video)
    labels = Labels.read(
        put(tmp_path, text, "v.csv"), mission_dir=video.mission.path, grid="2x2", annotator="eva"
    )
    labels.write(tmp_path / "out.csv", format="viame", mission_dir=video.mission.path)
    assert f"fps: {video.frames_per_second}" in (tmp_path / "out.csv").read_text()
    read = FORMATS["viame"].read(tmp_path / "out.csv", options)
    assert {record.frame for record in read.records} == {8}


def test_points_beyond_the_frame_show_that_the_pictures_were_larger(tmp_path, dive):
    """The file has no size: one point out of the frame says that all were put on another one."""
    out = io.StringIO()
    rows = csv.writer(out)
    rows.writerow(["Name", "Row", "Column", "Label"])
    rows.writerows([["frame_1.jpg", 10, 10, "ocean"], ["frame_1.jpg", 400, 10, "other"]])
    rows.writerows([["frame_2.jpg", 10, 10, "ocean"], ["frame_2.jpg", 90, 10, "other"]])
    rows.writerow(["frame_3.jpg", 10, 10, "ocean"])
    read = FORMATS["coralnet"].read(
        put(tmp_path, out.getvalue(), "points.csv"), ReadOptions(TAXONOMY, grid=GRID, images=dive)
    )
    assert {record.frame for record in read.records} == {2, 3}
    assert any("on 1 frame whose pictures were larger" in line for line in read.lost)


def test_a_file_of_another_dive_is_refused_unless_its_folder_is_named(tmp_path, dive):
    said = Said(1, 0, 0, "ocean", "dive_2/", 1, False, 0, True)
    path = put(tmp_path, _coco([said]))
    options = ReadOptions(TAXONOMY, images=dive)
    words = "its images are in 'dive_2', and the frames given are those of 'dive_1'."
    assert words in told(FORMATS["coco"].read, path, options)
    named = MissionImages(dive.mission, folder="dive_2")
    assert FORMATS["coco"].read(path, replace(options, images=named)).records


def test_both_folders_of_a_pair_are_told_apart(tmp_path):
    for side in ("Left", "Right"):
        (tmp_path / "dive_1" / side).mkdir(parents=True)
        image = np.zeros((48, 64), np.uint8)
        cv2.imwrite(str(tmp_path / "dive_1" / side / "1.png"), image)
    pair = MissionImages(open_mission(tmp_path / "dive_1"))
    assert pair.find("dive_1/Left/1.png").key == ("left", 1)
    assert pair.find("Right/1.png").key == ("right", 1)
    assert pair.find("dive_2/Right/1.png").folder == "dive_2"
    assert pair.find("1.png").key is None
    one = MissionImages(open_mission(tmp_path / "dive_1" / "Right"))
    assert one.find("dive_1/Right/1.png").key == one.find("1.png").key == ("left", 1)
    assert one.find("dive_1/Left/1.png").folder == "Left"
    assert one.find("dive_2/Right/1.png").folder == "dive_2"


def test_names_are_the_same_in_both_forms_of_unicode(tmp_path):
    cv2.imwrite(str(tmp_path / "Måøy_1.png"), np.zeros((48, 64), np.uint8))
    images = MissionImages(open_mission(tmp_path, "Krill\u00e9"))
    assert images.find("Ma\u030aøy_1.png").key == ("left", 1)
    (record,) = Labels.read(
        put(
            tmp_path, "mission,camera,frame,row,col,label\nKrille\u0301,left,1,0,0,ocean\n", "a.csv"
        ),
        annotator="A\u030ase",
    )
    assert (record.mission, record.annotator) == (images.name, "\u00c5se")


def test_classes_are_the_same_in_both_forms_of_unicode(tmp_path, dive):
    text = TAXONOMY.to_toml() + '[[classes]]\nname = "tare\u0301"\nobstacle = true\n'
    text += 'color = "#123456"\nkey = "9"\n'
    taxonomy = Taxonomy.load(put(tmp_path, text, "taxonomy.toml"))
    options = ReadOptions(taxonomy, grid=GRID, images=dive, classes={"ble\u0301": "tar\u00e9"})
    coco = json.loads(_coco([Said(1, 0, 0, "ocean", "", 1, False, 0, True)]))
    for name in ("tare\u0301", "tar\u00e9", "bl\u00e9", "ble\u0301"):
        coco["categories"][0]["name"] = name
        assert FORMATS["coco"].read(put(tmp_path, coco), options).records[0].label == "tar\u00e9"
        rows = f"mission,camera,frame,row,col,label\ndive_1,left,1,0,0,{name}\n"
        read = FORMATS["csv"].read(put(tmp_path, rows, "a.csv"), options)
        assert read.records[0].label == "tar\u00e9"


def test_files_of_two_people_with_one_name_do_not_replace_each_other(tmp_path):
    text = "mission,camera,frame,row,col,label\ndive,left,1,0,0,{}\n"
    for who, label in (("eva", "ocean"), ("bo", "reef")):
        (tmp_path / who).mkdir()
        put(tmp_path / who, text.format(label), "instances_default.csv")
    Labels.read(tmp_path / "eva" / "instances_default.csv").add_to(tmp_path)
    Labels.read(tmp_path / "eva" / "instances_default.csv").add_to(tmp_path)
    other = tmp_path / "bo" / "instances_default.csv"
    refuses("Give --annotator NAME", Labels.read(other).add_to, tmp_path)
    Labels.read(other, annotator="bo").add_to(tmp_path)
    with LabelStore(tmp_path / FILE_NAME) as store:
        assert {(r.annotator, r.label) for r in store.current()} == {
            ("instances_default", "ocean"),
            ("bo", "reef"),
        }


def test_where_most_frames_show_larger_pictures_none_is_believed(tmp_path, dive):
    text = "0,frame_1.jpg,0,0,0,1280,720,1,-1,ocean,1\n1,frame_2.jpg,1,20,10,60,50,1,-1,ocean,1\n"
    options = ReadOptions(TAXONOMY, grid=GRID, images=dive)
    words = "on 2 frames whose pictures were larger"
    assert words in told(FORMATS["viame"].read, put(tmp_path, text, "v.csv"), options)


def test_a_prefix_that_may_be_a_date_is_part_of_the_name(dive):
    assert dive.find("0a1b2c3d-frame_1.jpg").key == ("left", 1)
    assert dive.find("/data/upload/3/20190513-frame_1.jpg").key == ("left", 1)
    assert dive.find("20190513-frame_1.jpg").key is None


def test_a_dive_in_a_folder_of_images_is_known_by_the_folder_above(tmp_path):
    for name in ("dive_1", "dive_2"):
        (tmp_path / name / "images").mkdir(parents=True)
        cv2.imwrite(str(tmp_path / name / "images" / "f_1.png"), np.zeros((48, 64), np.uint8))
    images = MissionImages(open_mission(tmp_path / "dive_1" / "images"))
    assert images.find("images/f_1.png").key == images.find("dive_1/images/f_1.png").key
    assert images.find("dive_2/images/f_1.png").folder == "dive_2"


def test_boxes_of_a_task_with_two_pictures_go_to_theirs(tmp_path):
    for side in ("Left", "Right"):
        (tmp_path / "dive" / side).mkdir(parents=True)
        cv2.imwrite(str(tmp_path / "dive" / side / "1.png"), np.zeros((48, 64), np.uint8))
    place = {"x": 0, "y": 0, "width": 50, "height": 50, "rectanglelabels": ["ocean"]}
    size = {"original_width": 64, "original_height": 48}
    results = [
        {"type": "rectanglelabels", "to_name": name, "value": place, **size}
        for name in ("one", "two", "three")
    ]
    task = {
        "data": {"one": "dive/Left/1.png", "two": "dive/Right/1.png"},
        "annotations": [{"created_at": "then", "result": results}],
    }
    images = MissionImages(open_mission(tmp_path / "dive"))
    options = ReadOptions(TAXONOMY, grid=Grid(2, 2, None), images=images)
    read = FORMATS["labelstudio"].read(put(tmp_path, task), options)
    assert {record.camera for record in read.records} == {"left", "right"}
    assert "1 box left out: on one of several pictures of a task" in read.lost
    assert any(line.startswith("1 annotation taken as of now") for line in read.lost)


@pytest.mark.parametrize(
    ("clock", "position", "frame"), [("00:00:01", 14, 15), ("0:00:01", 25, 11)]
)
def test_a_time_in_whole_seconds_is_less_exact_than_a_frame_in_it(
    tmp_path, video, clock, position, frame
):
    text = f"0,{clock},{position},0,0,64,48,1,-1,ocean,1\n"
    options = ReadOptions(TAXONOMY, grid=Grid(2, 2, None), images=video)
    read = FORMATS["viame"].read(put(tmp_path, text, "v.csv"), options)
    assert video.frames_per_second == 10 and {record.frame for record in read.records} == {frame}


def test_odd_images_and_categories_cost_their_own_boxes(tmp_path, dive):
    said = [Said(n, 0, 0, "ocean", "", 1, False, 0, True) for n in (1, 2, 3)]
    value = json.loads(_coco(said))
    value["images"][0].pop("id")
    value["images"].append(7)
    value["annotations"][1]["score"] = None
    options = ReadOptions(TAXONOMY, grid=GRID, images=dive)
    read = FORMATS["coco"].read(put(tmp_path, value), options)
    assert {record.frame for record in read.records} == {2, 3}
    assert any("images 1: id None is not a whole number" in line for line in read.lost)


def test_a_frame_is_one_file_in_a_file_of_labels(tmp_path):
    rows = ["dive,left,1,0,0,ocean,a.jpg", "dive,left,1,0,1,ocean,b.jpg", "dive,left,2,0,0,reef,"]
    text = "\n".join(["mission,camera,frame,row,col,label,file", *rows])
    options = ReadOptions(TAXONOMY, classes={"reef": ""})
    read = FORMATS["csv"].read(put(tmp_path, text, "a.csv"), options)
    assert [(one.col, one.file) for one in read.records] == [(0, "a.jpg")]
    assert "1 label left out by --map: class 'reef'" in read.lost
    assert any("line 3: frame 1 is 'b.jpg' here" in line for line in read.lost)


def test_labels_follow_their_file_when_its_number_comes_to_be_shared(tmp_path):
    folder = tmp_path / "dive"
    folder.mkdir()
    picture = cv2.imencode(".png", np.zeros((48, 64), np.uint8))[1].tobytes()
    (folder / "T1-01.png").write_bytes(picture)
    path = put(tmp_path, "0,T1-01.png,0,0,0,64,48,1,-1,ocean,1\n", "v.csv")
    for new in (4, 0):
        labels = Labels.read(path, mission_dir=folder, grid="2x2", annotator="eva")
        assert labels.add_to(tmp_path).new == new
        (folder / "T2-01.png").write_bytes(picture)  # between the two imports
    mission = open_mission(folder)
    with LabelStore(tmp_path / FILE_NAME) as store:
        assert mission.number_of("T1-01.png") != 1
        store.keep_files(mission)
        assert mission.number_of("T1-01.png") == 1 == open_mission(folder).number_of("T1-01.png")
        assert {record.frame for record in store.current()} == {1}
