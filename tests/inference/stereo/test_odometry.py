import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.inference.stereo.odometry import load_odometry, motion_between, parse_odometry

HEADER = "frame,t,x_m,y_m,z_m,qw,qx,qy,qz"
STILL = "0,0,0,1,0,0,0"


def poses(*lines: str) -> str:
    return "\n".join([HEADER, *lines])


numbers = st.floats(-1000, 1000)
quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
    lambda values: np.linalg.norm(values) > 0.1
)


@given(st.dictionaries(st.integers(0, 10**6), st.tuples(numbers, numbers, numbers, quaternions)))
def test_what_is_written_is_read(written):
    lines, turned = [], {}
    for frame, (x, y, z, quaternion) in written.items():
        w, *axis = unit = np.array(quaternion) / np.linalg.norm(quaternion)
        lines.append(",".join(map(repr, (frame, 0.5, x, y, z, *unit.tolist()))))
        point = np.array([1.0, -2.0, 3.0])  # rotated by q p q*, from the definition
        turned[frame] = point + 2 * np.cross(axis, np.cross(axis, point) + w * point)
    if not written:
        refuses("holds no pose", parse_odometry, poses(), "o.csv")
        return
    read = parse_odometry(poses(*lines), "o.csv")
    assert set(read) == set(written)
    for frame, pose in read.items():
        assert pose.position_m.tolist() == list(written[frame][:3]) and pose.t == 0.5
        assert pose.rotation @ [1.0, -2.0, 3.0] == pytest.approx(turned[frame], abs=1e-9)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"7,0,{STILL},0", "line 3: 10 values where 9 are needed"),
        (f"7.5,0,{STILL}", "line 3: frame is not a whole number"),
        (f"-7,0,{STILL}", "line 3: frame is not a whole number"),
        (f"7,now,{STILL}", "line 3: t is not a number"),
        ("7,0,0,nan,0,1,0,0,0", "line 3: y_m is not finite"),
        ("7,0,0,1e7,0,1,0,0,0", "line 3: a position is more than 1000000 m away"),
        ("7,0,0,0,0,1,1,0,0", "line 3: the quaternion has length 1.414, not 1"),
        ("7,0,0,0,0,0,0,0,0", "line 3: the quaternion has length 0, not 1"),
        (f"6,0,{STILL}", "line 3: frame 6 comes twice"),
    ],
)
def test_a_malformed_line_is_named(line, words):
    refuses(words, parse_odometry, poses(f"6,0,{STILL}", line), "o.csv")


def test_a_file_is_read_or_refused(tmp_path):
    path = tmp_path / "o.csv"
    path.write_text("\ufeff" + poses(f" 6 , 0 ,{STILL}", "", f"9,1,{STILL}"), "utf-8")
    assert set(load_odometry(path)) == {6, 9}
    path.write_bytes(b"\xff\xfe\x00")
    refuses("not a text file", load_odometry, path)
    refuses("cannot read odometry", load_odometry, tmp_path)
    refuses("does not begin with the line frame,t,", parse_odometry, "frame;t", "o.csv")


def test_motion_is_the_way_back_into_the_moved_camera():
    half = np.sqrt(0.5)
    read = parse_odometry(poses("1,0,10,20,30,1,0,0,0", f"2,1,10,20,31,{half},0,{half},0"), "o.csv")
    # 1 m forward, then a quarter turn to the right: what was 3 m ahead is 2 m to the left.
    moved = motion_between(read[1], read[2]).of(np.array([[0.0, 0.5, 3.0]]))
    assert moved == pytest.approx(np.array([[-2.0, 0.5, 0.0]]))


def test_an_even_motion_is_the_sum_of_its_parts():
    turn = "0.9,0.3,0.1,-0.3"  # of length 1
    read = parse_odometry(poses("1,0,1,2,3,1,0,0,0", f"2,1,2,2,5,{turn}"), "o.csv")
    whole = motion_between(read[1], read[2])
    point = np.array([[0.5, -1.0, 4.0]])
    assert whole.last(1).of(point) == pytest.approx(whole.of(point))
    assert whole.last(0).of(point) == pytest.approx(point)
    assert whole.last(0.25).rotation @ whole.last(0.75).rotation == pytest.approx(whole.rotation)
