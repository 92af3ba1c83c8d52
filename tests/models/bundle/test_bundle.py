import dataclasses
import hashlib
import io
import json
import pickle
import random
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.calls import refuses
from tests.models.parts import Members, pack, rehash, unpack
from tokt.features.common.canonical import canonical_json
from tokt.features.common.errors import ToktError
from tokt.features.extractors.textures import PLAIN_IMAGE
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import (
    FORMAT_VERSION,
    Bundle,
    Golden,
    bundle_bytes,
    bundle_from_bytes,
    read_bundle,
)
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.water import WaterPrior

SEVERAL = (("ocean", False), ("sand", True), ("tower", True))


def npz(arrays: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def arrays_of(data: bytes) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(data)) as archive:
        return dict(archive)


def with_arrays(members: Members, member: str, **edit: Any) -> bytes:
    """A bundle, all hashes right, with some arrays of one member replaced or (None) left out."""
    arrays = {**arrays_of(members[member]), **edit}
    kept = {name: array for name, array in arrays.items() if array is not None}
    return rehash({**members, member: npz(kept)})


def fingerprint(bundle: Bundle) -> str:
    """Everything a model is and says, whatever the file looks like."""
    content, frame = bundle.content, np.arange(1536, dtype=np.uint8).reshape(32, 48)
    arrays = [
        content.model.weights,
        content.model.bias,
        content.model.thresholds,
        content.golden.decision_values,
        content.golden.obstacle,
        content.trained_on,
        bundle.decision_values(frame),
    ]
    words = [content.name, content.version, content.extractor_spec, content.grid.to_json()]
    more = [content.provenance, content.metrics, content.card, content.model.classes]
    more += [content.model.obstacle, content.operating_point.to_json()]
    return canonical_json([[array.tolist() for array in arrays], *words, *more])


def read(data: bytes) -> Bundle:
    return bundle_from_bytes(data, "file.tokt")


def refuse(data: bytes, words: str = ".") -> str:
    message = refuses(words, read, data)
    assert message.startswith("file.tokt: ") and len(message) < 400
    return message


@pytest.fixture(scope="module")
def content(make_content):
    return make_content()


@pytest.fixture(scope="module")
def data(content):
    return bundle_bytes(content)


@pytest.fixture(scope="module")
def members(data):
    return unpack(data)


@pytest.mark.parametrize("extractor", ["lbp", "haralick+lbp_24_8_frame"])
@pytest.mark.parametrize("classes", [(("ocean", False), ("other", True)), SEVERAL])
def test_round_trip(extractor, classes, make_content, tmp_path):
    content = make_content(3, extractor, classes)
    (tmp_path / "a.tokt").write_bytes(bundle_bytes(content))
    bundle = read_bundle(tmp_path / "a.tokt")
    found = bundle.content
    assert (bundle.name, bundle.version, bundle.label) == ("small", "3", "small/3")
    assert bundle.grid == content.grid
    assert found.extractor_spec == content.extractor_spec == bundle.extractor.spec
    assert (found.provenance, found.metrics) == (content.provenance, content.metrics)
    assert bundle.operating_point == content.operating_point
    assert found.card == content.card
    assert found.golden.frames == content.golden.frames
    for name in ("weights", "bias", "thresholds"):
        assert np.array_equal(getattr(found.model, name), getattr(content.model, name))
    assert (found.model.classes, found.model.obstacle) == tuple(zip(*classes, strict=True))
    assert np.array_equal(found.golden.obstacle, content.golden.obstacle)
    assert 0 < found.golden.obstacle.sum() < found.golden.obstacle.size
    assert sorted(found.trained_on) == sorted(content.trained_on)
    assert bundle.sha256 == hashlib.sha256((tmp_path / "a.tokt").read_bytes()).hexdigest()
    assert bundle_bytes(found) == bundle.data
    for png, expected in zip(found.golden.frames, content.golden.decision_values, strict=True):
        frame = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_ANYCOLOR)
        values = bundle.decision_values(np.asarray(frame, np.uint8))
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-9)


def test_same_content_same_bytes(make_content, data):
    again = make_content()
    provenance, trained_on = dict(reversed(again.provenance.items())), again.trained_on[::-1].copy()
    shuffled = dataclasses.replace(again, provenance=provenance, trained_on=trained_on)
    assert bundle_bytes(again) == bundle_bytes(shuffled) == data
    assert bundle_bytes(make_content(1)) != data


def test_layout(data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        infos = archive.infolist()
    names = ["manifest.json", "weights.npz", "golden.npz", "lineage.npz", "card.md"]
    assert [info.filename for info in infos] == names
    assert {info.date_time for info in infos} == {(1980, 1, 1, 0, 0, 0)}
    assert {info.compress_type for info in infos} == {zipfile.ZIP_STORED}


def test_nan_in_the_metrics_is_not_written(content):
    with pytest.raises(ValueError):
        bundle_bytes(dataclasses.replace(content, metrics={"f1": float("nan")}))


def zip_metadata(data: bytes) -> list[int]:
    """Offsets of what is neither a member's content nor inside it."""
    inside = bytearray(len(data))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for info in archive.infolist():
            start = info.header_offset + 30 + len(info.filename)
            inside[start : start + info.file_size] = b"\x01" * info.file_size
    return [offset for offset, byte in enumerate(inside) if not byte]


def test_a_changed_byte_is_refused_or_changes_nothing(data):
    truth = fingerprint(read(data))
    chance = random.Random(4)
    structure = zip_metadata(data)
    # Two bits of every byte that no hash covers, and all of them; a sample of the rest.
    bits = [(offset, chance.sample(range(8), 2)) for offset in structure]
    flips = [(offset, 1 << bit) for offset, two in bits for bit in two]
    flips += [(offset, 0xFF) for offset in structure]
    flips += [(offset, chance.randint(1, 255)) for offset in chance.sample(range(len(data)), 400)]
    accepted = 0
    for offset, mask in flips:
        edited = bytearray(data)
        edited[offset] ^= mask
        try:
            bundle = read(bytes(edited))
        except ToktError:
            continue
        assert offset in structure
        assert fingerprint(bundle) == truth, offset
        accepted += 1
    assert accepted < len(flips) / 2


def test_every_prefix_is_refused(data):
    for end in range(len(data)):
        refuses("", read, data[:end])


def test_not_a_bundle(tmp_path):
    refuses("No such file", read_bundle, tmp_path / "none.tokt")
    refuses("", read_bundle, tmp_path)
    (tmp_path / "notes.tokt").write_text("not a zip")
    refuses(r"notes\.tokt: truncated or damaged", read_bundle, tmp_path / "notes.tokt")
    refuse(pack({"data.txt": b"x"}), "not a tokt bundle")
    refuse(pack(dict.fromkeys("abcde", b"x")), "not a tokt bundle")
    refuse(pack({"manifest.json": b"[1]"}), "not a tokt bundle")
    refuse(pack({"manifest.json": b"{"}), "not JSON")
    refuse(pack({"manifest.json": b"\xff\xfe\xff"}), "not JSON")
    refuse(pack({"manifest.json": b"[" * 200_000}), "not JSON")
    refuse(pack({"manifest.json": b'{"format_version":' + b"9" * 5000 + b"}"}), "not JSON")
    refuse(pack({"manifest.json": b"{}"}), "no format version")


@pytest.mark.parametrize("name", ["weights.npz", "golden.npz", "lineage.npz", "card.md"])
def test_members_added_removed_renamed_exchanged(members, name):
    rest = {key: value for key, value in members.items() if key != name}
    refuse(pack(rest), "unknown or missing members")
    refuse(pack({**rest, f"x{name}": members[name]}), "unknown or missing members")
    refuse(pack({**members, "more": b""}), "unknown or missing members")
    refuse(pack({**members, name: members[name] + b"\n"}), f"{name} in the bundle has been edited")
    # The same with a manifest that names just what is there.
    refuse(rehash(rest))
    refuse(rehash({**rest, f"x{name}": members[name]}))
    refuse(rehash({**members, "more": b""}))


def test_a_member_twice(members):
    buffer = io.BytesIO(pack(members))
    with zipfile.ZipFile(buffer, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("card.md", members["card.md"])
    refuse(buffer.getvalue(), "twice")


def test_compressed(members):
    for way in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        refuse(pack(members, way), "compressed")


def test_a_bomb_is_refused_before_it_unfolds(members):
    bomb = io.BytesIO()
    with (
        zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("weights.npy", "w") as handle,
    ):
        for _ in range(70):
            handle.write(bytes(1 << 20))
    tracemalloc.start()
    refuse(bomb.getvalue())
    refuse(rehash({**members, "weights.npz": bomb.getvalue()}), r"weights\.npz")
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


def test_a_large_member_is_refused(members):
    refuse(pack({**members, "card.md": bytes((64 << 20) + 1)}), "too large")


MANIFEST_EDITS: list[tuple[str, Any]] = [
    ("name", "another"),
    ("version", "9"),
    ("extractor", {}),
    ("grid", {"rows": 3, "cols": 2, "width": 36}),
    ("classes", [{"name": "ocean", "obstacle": True}, {"name": "other", "obstacle": True}]),
    ("provenance", {}),
    ("metrics", {"patch": {"f1": 1.0}}),
    ("operating_point", OperatingPoint(MofNRule(0.5, 2, 2, 4)).to_json()),
]


@pytest.mark.parametrize(("key", "value"), MANIFEST_EDITS)
def test_an_edited_manifest(members, key, value):
    manifest = json.loads(members["manifest.json"])
    manifest[key] = value
    edited = pack({**members, "manifest.json": json.dumps(manifest).encode()})
    refuse(edited, "manifest has been edited")


def test_an_edited_member_with_its_hash_but_not_the_manifests(members):
    manifest = json.loads(members["manifest.json"])
    card = b"# the best model there is\n"
    manifest["members"]["card.md"] = hashlib.sha256(card).hexdigest()
    edited = {**members, "card.md": card, "manifest.json": json.dumps(manifest).encode()}
    refuse(pack(edited), "manifest has been edited")


def test_hash_of_the_wrong_kind(members):
    manifest = json.loads(members["manifest.json"])
    for wrong in (None, 1, [], "", manifest["manifest_sha256"].upper()):
        edited = json.dumps({**manifest, "manifest_sha256": wrong}).encode()
        refuse(pack({**members, "manifest.json": edited}), "manifest has been edited")
    infinite = members["manifest.json"].replace(b'"f1": 0.5', b'"f1": Infinity')
    assert infinite != members["manifest.json"]
    refuse(pack({**members, "manifest.json": infinite}), "manifest has been edited")


def test_manifest_entries_added_or_missing(members):
    refuse(rehash(members, {"note": "x"}), "unknown or missing entries")
    manifest = json.loads(members["manifest.json"])
    for key in set(manifest) - {"manifest_sha256", "members", "format_version"}:
        less = json.dumps({name: value for name, value in manifest.items() if name != key})
        refuse(rehash({**members, "manifest.json": less.encode()}), "unknown or missing entries")


def test_format_versions(members):
    assert "newer than this tokt" in refuse(rehash(members, {"format_version": FORMAT_VERSION + 1}))
    # Whatever else a newer format changes, that is what is said.
    assert "newer" in refuse(pack({"manifest.json": b'{"format_version": 99}', "x": b""}))
    for wrong in (0, -1, None, "1", 1.0, True, [1]):
        refuse(rehash(members, {"format_version": wrong}), "no format version")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    "newer", [{"water": WaterPrior(-1.0, 1.0, 0.5, 0.5, 0.25).to_json()}, {"unlike": 2.0}]
)
def test_an_older_format_has_nothing_of_a_newer_one(version, newer):
    old = unpack((Path(__file__).parent / f"bundle_of_format_{version}.zip").read_bytes())
    point = json.loads(old["manifest.json"])["operating_point"]
    edited = rehash(old, {"operating_point": {**point, **newer}})
    assert f"its format knows no {next(iter(newer))} in an operating point" in refuse(edited)


OCEAN = {"name": "ocean", "obstacle": False}
WRONG_ENTRIES: list[tuple[str, Any]] = [
    *[(key, wrong) for key, _ in MANIFEST_EDITS for wrong in (None, 3, [], [[]])],
    ("name", ""),
    ("extractor", {"name": "lbp"}),
    ("extractor", {"name": "join", "version": 1, "parts": 3}),
    ("operating_point", {**MofNRule(0.5, 2, 2, 3).to_json(), "chosen": []}),
    *[
        ("operating_point", {**MofNRule().to_json(), key: value, "chosen": {}})
        for key, value in (("hits", 2), ("least_patches", 7), ("margin_now", 10**400))
    ],
    *[
        ("operating_point", {**MofNRule().to_json(), "margin": value, "chosen": {}})
        for value in (-1.0, 10**400, 1e308)
    ],
    ("metrics", {"patch": 3}),
    ("extractor", {"name": "lines", "version": 1, "samples": [*range(9999)], "image": PLAIN_IMAGE}),
    ("grid", {"rows": 2, "cols": 3}),
    *[("grid", {"rows": rows, "cols": 3, "width": 36}) for rows in ("2", 2.0, 0)],
    ("grid", {"rows": 3, "cols": 2, "width": 36}),
    ("grid", {"rows": 2, "cols": 3, "width": 48}),
    ("classes", [OCEAN]),
    *[("classes", [OCEAN, {"name": "other", "obstacle": flag}]) for flag in (1, "yes", False)],
    *[("classes", [OCEAN, {"name": name, "obstacle": True}]) for name in (5, "ocean")],
    ("classes", [{"name": "other", "obstacle": True}, OCEAN]),
    ("classes", {"ocean": False, "other": True}),
]


@pytest.mark.parametrize(("key", "value"), WRONG_ENTRIES, ids=lambda value: repr(value)[:40])
def test_consistent_hashes_do_not_make_nonsense_right(members, key, value):
    refuse(rehash(members, {key: value}))


@pytest.mark.parametrize(
    ("rows", "cols", "width"),
    [
        *[(10**6, 10**6, None), (10**15, 3, 36), (10**400, 10**400, None)],
        *[(2, 3, 10**9), (2, 3, 10**30)],
    ],
    ids=["squares", "rows", "endless", "width", "wider"],
)
def test_a_huge_grid_allocates_nothing(members, rows, cols, width):
    edited = rehash(members, {"grid": {"rows": rows, "cols": cols, "width": width}})
    tracemalloc.start()
    refuse(edited)
    assert tracemalloc.get_traced_memory()[1] < 5e6
    tracemalloc.stop()


def test_a_moved_threshold(members):
    """Every hash is right and the decision values are the same; the verdicts are not."""
    moved = arrays_of(members["weights.npz"])["thresholds"] + 1e3
    edited = with_arrays(members, "weights.npz", thresholds=moved)
    refuse(edited, "golden frame 0 gives other obstacle patches")


def test_moved_weights(members):
    arrays = arrays_of(members["weights.npz"])
    refuse(with_arrays(members, "weights.npz", bias=arrays["bias"] + 1e-6), "golden frame 0")
    refuse(with_arrays(members, "weights.npz", weights=-arrays["weights"]), "golden frame 0")
    read(with_arrays(members, "weights.npz", bias=arrays["bias"] + 1e-11))


def test_moved_golden_values(members):
    values = arrays_of(members["golden.npz"])["decision_values"]
    for change in (1e-6, -1e-6, np.nan, np.inf):
        edited = values.copy()
        edited[1, -1, 0] += change
        message = refuse(with_arrays(members, "golden.npz", decision_values=edited))
        assert "golden frame 1 gives decision values that differ" in message
    flags = arrays_of(members["golden.npz"])["obstacle"]
    flags[1, 2] = not flags[1, 2]
    refuse(with_arrays(members, "golden.npz", obstacle=flags), "golden frame 1 gives other")


def png(image: Any) -> bytes:
    return bytes(cv2.imencode(".png", image)[1].tobytes())


@pytest.mark.parametrize(
    "frame",
    [
        *[png(np.zeros(size, np.uint8)) for size in ((1, 60), (4, 60), (100_000, 1))],
        *[png(np.zeros((32, 48), np.uint8))[:-9], b"not a picture"],
    ],
    ids=["flat", "low", "thin", "cut", "junk"],
)
def test_golden_frames_that_cannot_be_judged(members, frame):
    golden = arrays_of(members["golden.npz"])
    arrays = {name: golden[name][:1] for name in ("decision_values", "obstacle")}
    arrays |= {"frames": np.frombuffer(frame, np.uint8), "sizes": np.array([len(frame)])}
    refuse(with_arrays(members, "golden.npz", **arrays), "golden frame")


WRONG_ARRAYS: list[tuple[str, str, Any]] = [
    ("weights.npz", "weights", None),
    ("weights.npz", "weights", np.ones((1, 12), np.float32)),
    *[("weights.npz", "weights", np.ones(shape)) for shape in ((1, 13), (2, 12), 12)],
    ("weights.npz", "weights", np.full((1, 12), np.nan)),
    ("weights.npz", "weights", np.array([[None] * 12])),
    ("weights.npz", "bias", np.full(1, np.inf)),
    ("weights.npz", "thresholds", np.full(1, np.nan)),
    ("weights.npz", "more", np.zeros(1)),
    *[
        ("golden.npz", "sizes", np.array(sizes, np.int64))
        for sizes in ([], [1, 2], [-5, 7], [2**63 - 1, 2**63 - 1], [[1], [2]])
    ],
    ("golden.npz", "frames", np.zeros(0, np.uint8)),
    *[
        ("golden.npz", "decision_values", np.zeros(shape))
        for shape in ((2, 6), (2, 7, 1), (2, 6, 2), (1, 6, 1))
    ],
    ("golden.npz", "obstacle", np.zeros((2, 5), bool)),
    ("lineage.npz", "trained_on", np.zeros((3, 3), np.uint64)),
    ("lineage.npz", "trained_on", None),
]


@pytest.mark.parametrize(("member", "name", "array"), WRONG_ARRAYS)
def test_wrong_arrays(members, member, name, array):
    refuse(with_arrays(members, member, **{name: array}))


class Harm:
    """Leaves a trace when it is unpickled."""

    done = False

    def __reduce__(self) -> Any:
        return setattr, (Harm, "done", True)


def test_pickles_are_never_loaded(members):
    arrays: dict[str, Any] = arrays_of(members["weights.npz"])
    arrays["weights"] = np.array([[Harm()] * 12], object)
    refuse(rehash({**members, "weights.npz": npz(arrays)}), r"weights\.npz")
    refuse(rehash({**members, "weights.npz": pickle.dumps(Harm())}), r"weights\.npz")
    refuse(rehash({**members, "weights.npz": pack({"weights.npy": pickle.dumps(Harm())})}))
    assert not Harm.done


def header(text: str) -> bytes:
    raw = text.encode("latin1")
    return b"\x93NUMPY\x01\x00" + len(raw).to_bytes(2, "little") + raw


@pytest.mark.parametrize(
    "member",
    [
        b"",
        b"text",
        header("{}"),
        header("(" * 5000),
        *[
            header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({size},)}}")
            for size in ("10**9", 10**15, 10**23 - 1, -1)
        ],
        *[
            header(f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': (1,)}}")
            for descr in ("|O", [], "nonsense")
        ],
    ],
    ids=range(11),
)
def test_wrong_npy_members(members, member):
    refuse(rehash({**members, "weights.npz": member}), r"weights\.npz")
    for name in ("weights", "bias", "thresholds"):
        inner = {**unpack(members["weights.npz"]), f"{name}.npy": member}
        refuse(rehash({**members, "weights.npz": pack(inner)}), r"weights\.npz")


def test_the_extractor_must_fit_the_weights(content, make_content):
    other = make_content(0, "haralick")
    mixed = dataclasses.replace(content, extractor_spec=other.extractor_spec)
    refuse(bundle_bytes(mixed), "takes 12 features, its extractor gives 13")
    spec = {**content.extractor_spec, "border": "frame"}
    border = dataclasses.replace(content, extractor_spec=spec)
    refuse(bundle_bytes(border), "golden frame 0 gives decision values")
    assert content.grid == Grid(2, 3, 36)


def test_a_film_is_not_read_into_memory(tmp_path):
    film = tmp_path / "dive.mp4"
    with film.open("wb") as handle:
        handle.truncate(1 << 40)
    refuses("too large", read_bundle, film)


@pytest.mark.parametrize(
    ("classes", "fault"),
    [
        ((("ocean", False), ("other", True)), ""),
        ((("ocean", False), ("water", False)), "could never warn"),
        ((("reef", True), ("sand", True)), "would always warn"),
    ],
)
def test_a_model_that_cannot_guard_says_so(make_content, classes, fault):
    bundle = bundle_from_bytes(bundle_bytes(make_content(classes=classes)), "x")
    assert fault in bundle.deployment_fault and bool(fault) == bool(bundle.deployment_fault)
    assert bundle.frame_sizes == ((32, 48),)


def test_every_size_that_was_learnt_from_is_in_the_file(make_content):
    sizes = ((32, 48), (576, 1024), (100, 900))
    content = dataclasses.replace(make_content(), frame_sizes=sizes)
    assert bundle_from_bytes(bundle_bytes(content), "x").frame_sizes == sizes
    members = unpack(bundle_bytes(content))
    for wrong in ([], 3, [[32]], [[32, 0]], [[32, True]], [[32, 10**9]], [["32", 48]], [[1, 1, 1]]):
        assert "does not fit together" in refuse(rehash(members, {"frame_sizes": wrong}))


def test_the_rounds_of_a_boundary_are_said_from_format_6_on():
    old = unpack((Path(__file__).parent / "bundle_of_format_5.zip").read_bytes())
    point = json.loads(old["manifest.json"])["operating_point"]
    told = {**point, "water": {**point["water"], "rounds": 6}}
    assert "rounds from format 6 on" in refuse(rehash(old, {"operating_point": told}))
    newer = {"format_version": 6, "frame_sizes": [[32, 48]]}
    assert "rounds from format 6 on" in refuse(rehash(old, newer))
    bundle_from_bytes(rehash(old, {**newer, "operating_point": told}), "x")


def test_large_decision_values_are_held_to_their_own_scale(make_content):
    """Unscaled features give values in the thousands: 1e-9 of those, and no more."""
    content = make_content()
    larger = {
        name: getattr(content.model, name) * 1e4 for name in ("weights", "bias", "thresholds")
    }
    scaled = dataclasses.replace(content.model, **larger)
    values = content.golden.decision_values * 1e4
    for error, good in ((1e-6, True), (1e-3, False)):
        golden = dataclasses.replace(content.golden, decision_values=values + error)
        data = bundle_bytes(dataclasses.replace(content, model=scaled, golden=golden))
        if good:
            bundle_from_bytes(data, "x")
        else:
            refuses("training machine", bundle_from_bytes, data, "x")


@pytest.mark.parametrize("key", ["name", "version"])
@pytest.mark.parametrize("text", ["x" * 101, "a\nb", "\x1b[2J", "\ud800"])
def test_a_name_that_no_datagram_or_terminal_should_carry(members, key, text):
    data = rehash(members, {key: text})
    assert refuses(r"is not a name|is not JSON", bundle_from_bytes, data, "b.tokt").isprintable()


def test_golden_frames_that_say_they_are_huge_or_are_many(make_content):
    content = make_content()
    golden = content.golden
    png = bytearray(golden.frames[0])
    png[16:24] = (20_000).to_bytes(4, "big") * 2
    huge = dataclasses.replace(golden, frames=(bytes(png), golden.frames[1]))
    values = np.concatenate([golden.decision_values] * 51)
    flags = np.concatenate([golden.obstacle] * 51)
    for wrong in (huge, Golden(golden.frames * 51, values, flags)):
        data = bundle_bytes(dataclasses.replace(content, golden=wrong))
        refuse(data, "more than a bundle needs")


@pytest.mark.parametrize("shape", [b"(9L,),}", b"(%d,),}" % 2**64])  # of Python 2, beyond int64
def test_a_header_that_numpy_warns_of_is_refused_without_a_warning(members, recwarn, shape):
    arrays = unpack(members["lineage.npz"])
    npy = arrays["trained_on.npy"]
    arrays["trained_on.npy"] = npy.replace(b"(9,), }".ljust(len(shape)), shape)
    assert len(arrays["trained_on.npy"]) == len(npy) and shape in arrays["trained_on.npy"]
    refuse(rehash({**members, "lineage.npz": pack(arrays)}), "cannot be read")
    assert not recwarn.list


def test_a_member_of_many_directory_entries_is_not_read_for_each(members):
    """Entries that point at the same bytes cost a file nothing; reading each would take days."""
    data = bytearray(pack(members))
    end = data.rindex(b"PK\x05\x06")
    begin = int.from_bytes(data[end + 16 : end + 20], "little")
    directory = bytes(data[begin:end]) * 12
    data[end + 8 : end + 12] = (12 * len(members)).to_bytes(2, "little") * 2
    data[end + 12 : end + 16] = len(directory).to_bytes(4, "little")
    refuse(bytes(data[:begin]) + directory + bytes(data[end:]), "a member is in it twice")
