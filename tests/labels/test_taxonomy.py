import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.labels.taxonomy import UNSURE, LabelClass, Taxonomy, load_taxonomy

OCEAN = '[[classes]]\nname = "ocean"\nobstacle = false\ncolor = "#0000ff"\nkey = "1"\n'
WRECK = '[[classes]]\nname = "wreck"\nobstacle = true\ncolor = "#ff0000"\nkey = "2"\n'


def _write(folder, text):
    path = folder / "taxonomy.toml"
    path.write_text(text, "utf-8")
    return path


def test_packaged_taxonomy_has_the_five_classes():
    taxonomy = Taxonomy.load()
    assert taxonomy.names == ("ocean", "other", "sand", "reef", "subsea_installation")
    assert [name for name in taxonomy.names if not taxonomy.is_obstacle(name)] == ["ocean"]
    assert len({known.color for known in taxonomy.classes}) == 5


def test_json_round_trip():
    taxonomy = Taxonomy.load()
    assert Taxonomy.from_json(taxonomy.to_json()) == taxonomy


def test_unsure_is_a_label_but_never_a_class():
    taxonomy = Taxonomy.load()
    taxonomy.check_label(UNSURE)
    assert UNSURE not in taxonomy.names
    refuses("unknown class 'unsure'", taxonomy.is_obstacle, UNSURE)


def test_unknown_class_names_the_known_ones():
    message = "unknown class 'Ocean'; known: ocean, other, sand"
    refuses(message, Taxonomy.load().check_label, "Ocean")


def test_workspace_file_adds_a_class_and_a_given_file_wins(tmp_path):
    own = _write(tmp_path, f"format = 1\n{OCEAN}{WRECK}")
    assert load_taxonomy(tmp_path).is_obstacle("wreck")
    assert load_taxonomy(tmp_path / "elsewhere") == Taxonomy.load()
    other = tmp_path / "other"
    other.mkdir()
    given = _write(other, own.read_text().replace("wreck", "cage"))
    assert load_taxonomy(tmp_path, given).names == ("ocean", "cage")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = 1", "no .*classes"),
        (OCEAN, "format = 1"),
        (f"format = 3\n{OCEAN}{WRECK}", "format 3 is newer"),
        (f"format = 1\ncolour = 2\n{OCEAN}{WRECK}", "unknown field 'colour'"),
        (f"format = 1\n{OCEAN}", "obstacle = true"),
        (f"format = 1\n{OCEAN}{WRECK}{WRECK}", "two classes are named 'wreck'"),
        (f"format = 1\n{OCEAN}{WRECK.replace('2', '1')}", "two classes have the key '1'"),
        (f"format = 1\n{OCEAN}{WRECK.replace('#ff0000', 'red')}", "'wreck': color 'red'"),
        (f"format = 1\n{OCEAN}{WRECK.replace('wreck', 'unsure')}", "'unsure' cannot be"),
        (f"format = 1\n{OCEAN}{WRECK.replace('wreck', 'a  wreck')}", "a name is"),
        (f"format = 1\n{OCEAN}{WRECK.replace('true', '1')}", "obstacle must be true or false"),
        (f"format = 1\n{OCEAN}{WRECK.replace('obstacle', 'obstacles')}", "has no obstacle"),
        (f"format = 1\n{OCEAN}{WRECK.replace(chr(34) + '2', chr(34) + '22')}", "one character"),
        (f"format = 1\n{OCEAN}{WRECK.replace('2', 'u')}", "kept for 'unsure'"),
        ("format = [", "Invalid value"),
    ],
)
def test_mistakes_are_one_line_with_the_file(tmp_path, text, message):
    path = _write(tmp_path, text)
    assert str(path) in refuses(message, Taxonomy.load, path)


def test_missing_or_binary_file_is_a_user_error(tmp_path):
    refuses("No such file", Taxonomy.load, tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    refuses("not UTF-8", Taxonomy.load, tmp_path / "binary.toml")


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 3000])
def test_toml_that_python_s_reader_gives_up_on(tmp_path, value):
    (tmp_path / "t.toml").write_text(f"format = {value}\n")
    refuses(r"taxonomy .*t\.toml: ", Taxonomy.load, tmp_path / "t.toml")


def test_a_file_of_yesterday_is_read_and_written_as_it_was(tmp_path):
    taxonomy = load_taxonomy(_write(tmp_path, f"format = 1\n{OCEAN}{WRECK}").parent)
    assert {known.parent for known in taxonomy.classes} == {""}
    assert taxonomy.to_json()["format"] == 1 and "parent" not in taxonomy.to_json()["classes"][0]
    assert taxonomy.to_toml().startswith("format = 1\n")


def test_a_tree_of_classes(tmp_path):
    coral = OCEAN.replace("false", "true").replace("1", "3").replace("ocean", "stony coral")
    tree = f'format = 2\n{OCEAN}{WRECK}{coral}parent = "wreck"\n'
    taxonomy = load_taxonomy(_write(tmp_path, tree).parent)
    assert taxonomy.classes[2].parent == "wreck" and taxonomy.to_json()["format"] == 2
    for wrong, said in (
        (tree.replace("wreck", "stony coral", 1), "two classes are named"),
        (tree.replace(WRECK, f'{WRECK}parent = "stony coral"\n'), "among its own parents"),
        (tree.replace("true", "false").replace("false", "true", 2), "is clear, its parent"),
        (tree.replace('parent = "wreck"', 'parent = "unsure"'), "is no name of a class or a group"),
        (tree.replace('parent = "wreck"', 'parent = "stony coral"'), "among its own parents"),
        (tree.replace("stony coral", "stony  coral"), "single blanks"),
    ):
        refuses(said, Taxonomy.load, _write(tmp_path, wrong))


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)


@given(texts, st.sampled_from(["", "wreck", "benthos", "sea floor"]))
def test_what_is_written_is_read_back(tmp_path_factory, description, parent):
    known = Taxonomy.load().classes
    wreck = LabelClass("wreck", True, "#123abc", '"', description, "")
    other = LabelClass("old wreck", True, "#123abc", "\\", description, parent)
    taxonomy = Taxonomy((*known, wreck, other))
    path = tmp_path_factory.getbasetemp() / "written.toml"
    path.write_bytes(taxonomy.to_toml().encode())
    assert Taxonomy.load(path) == taxonomy == Taxonomy.from_json(taxonomy.to_json())
