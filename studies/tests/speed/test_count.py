"""`tokt bench --count`: what belongs to which stage, and no stage grows by a tenth unseen."""

import json
import shutil

import numpy as np
import pytest

from studies.tests.speed.stage_counts import ANEW, STORED, changes, other_code, table
from tests.calls import refused, refuses, succeeds
from tokt.features.kernels.dispatch import COMPILED, KERNELS
from tokt_studies.speed.count_report import print_counts
from tokt_studies.speed.counted_run import LOOP, PUBLISH, STAGES, START, WARM_UP, Cuts
from tokt_studies.speed.instruction_count import (
    COUNTED,
    LINE_BYTES,
    InstructionCount,
    counted_parts,
    run_count,
    stage_costs,
)

needs_valgrind = pytest.mark.skipif(
    not (shutil.which("valgrind") and shutil.which("vgdb")), reason="apt-get install valgrind"
)


@needs_valgrind
@pytest.mark.skipif(KERNELS.name != COMPILED, reason="it is the compiled kernels that are stored")
def test_no_stage_of_a_run_grows_by_a_tenth(tmp_path):
    out = tmp_path / "out"
    found = json.loads(succeeds("bench", "--count", "--json", "--out", out).out)
    assert json.loads((out / "count.json").read_text("utf-8")) == found
    assert found["said"] == {"obstacle": COUNTED} and found["object"] == {"held": COUNTED}
    totals = found["totals"]
    for key in ("instructions", "bytes_moved"):
        assert totals["all"][key] == pytest.approx(totals["before"][key] + totals["after"][key])
        assert min(stage[key] for stage in found["stages"]) > 0
    stored, now = json.loads(STORED.read_text("utf-8")), table(found)
    if other := other_code(stored, now):
        pytest.skip(f"{STORED.name} was written with other code: {other}")
    changed = changes(stored["stages"], now["stages"])
    assert not changed, "\n".join([*changed, ANEW])


OF_A_MODEL = ("quantize", "haralick", "lbp", "lines", "features", "decision")


@needs_valgrind
@pytest.mark.skipif(KERNELS.name != COMPILED, reason="it is the compiled kernels that are stored")
def test_what_is_a_lite_models_own_takes_a_third_of_that_of_the_best(tmp_path):
    out = ("--json", "--out", tmp_path / "out")
    lite = table(json.loads(succeeds("bench", "--count", "--preset", "lite", *out).out))
    best = json.loads(STORED.read_text("utf-8"))
    if other := other_code(best, lite):
        pytest.skip(f"{STORED.name} was written with other code: {other}")
    of_best, of_lite = (
        {name: one["stages"].get(f"{name}, before the datagram", 0.0) for name in OF_A_MODEL}
        for one in (best, lite)
    )
    # Of these a lite model has none: they are the named object's, as in the run of the best.
    of_the_object = of_lite["haralick"] + of_lite["lbp"]
    shares = [sum(stages.values()) - of_the_object for stages in (of_lite, of_best)]
    assert shares[0] <= shares[1] / 3


def test_a_stage_that_grew_or_shrank_is_told():
    stored = {"sight": 4.0, "log": 0.8, "drift": 1.2}
    assert changes(stored, stored) == []
    assert changes(stored, {"sight": 4.39, "log": 0.73, "drift": 1.2}) == []
    assert changes(stored, {**stored, "sight": 4.41}) == [
        "sight: 4.00 to 4.41 million instructions (+10%)"
    ]
    assert changes(stored, {**stored, "log": 0.4}) == [
        "log: 0.80 to 0.40 million instructions (-50%)"
    ]
    assert changes(stored, {"sight": 4.0, "drift": 1.2, "flow": 9.0}) == [
        *("log: is gone", "flow: is new")
    ]


def test_counts_of_other_code_are_not_compared():
    stored = {"code": {"kernels": "compiled, avx2 instructions", "numpy": "2.4.6"}}
    assert other_code(stored, stored) == ""
    found = {"code": {**stored["code"], "numpy": "2.5.0"}}
    assert other_code(stored, found) == "numpy 2.5.0, not 2.4.6"


def test_the_stored_stages_are_those_that_there_are():
    stages = {name.partition(", ")[0] for name in json.loads(STORED.read_text("utf-8"))["stages"]}
    assert stages <= {LOOP, *STAGES}
    for methods in STAGES.values():
        assert methods and all(callable(getattr(owner, name)) for owner, name in methods)


def test_a_stage_has_what_it_does_itself():
    """Each segment is of the stage that was entered last, before and after the datagram."""
    cuts = Cuts()
    look = cuts.method("sight", lambda: None)
    judge = cuts.method("decision", lambda: (look(), look_twice()))
    look_twice = cuts.method("sight", look)  # its own stage's method is no stage in it
    publish, log = cuts.method(PUBLISH, lambda: None), cuts.method("log", lambda: None)
    for _ in cuts.pictures(np.zeros((WARM_UP + 2, 1, 1), np.uint8)):
        for call in (judge, publish, log):
            call()
    frame = [
        *((LOOP, False), ("decision", False), ("sight", False), ("decision", False)),
        *(("sight", False), ("decision", False), (LOOP, False), (PUBLISH, False)),
        *((LOOP, True), ("log", True), (LOOP, True)),
    ]
    assert cuts.segments == [(START, False), *frame, *frame]


def test_a_method_that_raises_ends_its_stage():
    cuts = Cuts()

    def fail():
        raise KeyError

    failing = cuts.method("sight", fail)
    for _ in cuts.pictures(np.zeros((WARM_UP + 1, 1, 1), np.uint8)):
        with pytest.raises(KeyError):
            failing()
    assert [stage for stage, _ in cuts.segments] == [START, LOOP, "sight", LOOP]


CALLGRIND = """version: 1
creator: callgrind-3.19.0
part: 1
events: Ir Dr I1mr ILmr DLmr DLmw
fn=(1) totals: of a function
totals: 9000 10 9 9 9 9
part: 2
events: Ir Dr I1mr ILmr DLmr DLmw
totals: 600 10 9 1 2 3
part: 3
events: Ir Dr I1mr ILmr DLmr DLmw
totals: 60
part: 4
events: Ir Dr I1mr ILmr DLmr DLmw
totals: 1200 10 9 0 6
part: 5
events: Ir Dr I1mr ILmr DLmr DLmw
totals: 5000 1 1 1 1 1
"""
SEGMENTS = [(START, False), (LOOP, False), ("log", True), (LOOP, False)]


@pytest.fixture
def counted(tmp_path):
    (tmp_path / "callgrind.out").write_text(CALLGRIND)
    return list(counted_parts(tmp_path / "callgrind.out"))


def test_what_was_counted_is_summed_up_by_stage(counted):
    loop, log = stage_costs(SEGMENTS, counted)
    assert (loop.stage, loop.when, log.stage, log.when) == (LOOP, "before", "log", "after")
    assert (loop.instructions, log.instructions) == (1800 / COUNTED, 60 / COUNTED)
    assert (loop.bytes_moved, log.bytes_moved) == (12 * LINE_BYTES / COUNTED, 0)
    refuses("callgrind wrote 5 parts of 4", stage_costs, SEGMENTS[:-1], counted)


def test_the_table_has_sums_up_to_the_datagram_and_after_it(counted, capsys):
    about = {"preset": "best", "frame_size": "1360x1024 colour", "frames": 6, "caches": {}}
    about |= {"said": {"clear": 6}, "object": {"held": 6}, "code": {"numpy": "2.4.6"}}
    print_counts(InstructionCount(stage_costs(SEGMENTS, counted), about))
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["before", "the", "datagram", "0.00", "96.8%", "0"] in lines
    assert ["a", "frame", "0.00", "100.0%", "0"] in lines


def test_what_cannot_be_counted_is_refused(tmp_path, monkeypatch):
    refused("--frames is not for --count", "bench", "--count", "--frames", 4)
    refused("--preset is for --count", "bench", "--preset", "water")
    (tmp_path / "file").touch()
    refused("is not a folder", "bench", "--count", "--out", tmp_path / "file")
    refused("unknown preset 'no'", "bench", "--count", "--preset", "no", "--out", tmp_path / "out")
    monkeypatch.setenv("PATH", str(tmp_path))
    refuses("apt install valgrind", run_count, tmp_path / "out", "best", None, None)
    assert not (tmp_path / "out").exists()
