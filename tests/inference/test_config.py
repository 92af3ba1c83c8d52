"""The description of a run: the command line, configuration files and the log's start from it."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.calls import refused, run_python
from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.inference.assembly.option_checks import check_options
from tokt.inference.config import OPTIONS, SECTIONS, Option, RunConfig, read_config
from tokt.inference.recording.run_start import RunStart

DOCS = Path(__file__).parents[2] / "docs"
DIVE = DOCS / "dive.toml"

# A path is what pathlib makes of it; a command line holds no NUL, and a file only Unicode.
text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8)
VALUES: dict[Any, st.SearchStrategy[Any]] = {
    bool: st.booleans(),
    int: st.integers(-(10**20), 10**20),
    float: st.floats(allow_nan=False),
    str: text,
    Path: text.map(Path),
}


def values_of(option: Option) -> st.SearchStrategy[Any]:
    one = VALUES[option.kind]
    return st.lists(one, min_size=1, max_size=3) if option.many else one


some_options = st.fixed_dictionaries(
    {}, optional={name: values_of(option) for name, option in OPTIONS.items()}
).filter(lambda values: not {"store", "bundle"} <= values.keys())


def command_line(values: dict[str, Any]) -> list[str]:
    """The options as a user types them."""
    words = []
    for name, value in values.items():
        key = OPTIONS[name].key
        if isinstance(value, bool):
            words.append(f"--{key}" if value else f"--no-{key}")
        else:
            words += [f"--{key}={one}" for one in (value if OPTIONS[name].many else [value])]
    return words


def written(folder: Path, content: str) -> Path:
    path = folder / "dive.toml"
    path.write_text(content, "utf-8")
    return path


@settings(max_examples=scaled(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=some_options)
def test_a_printed_run_is_the_same_run(tmp_path, run_tokt, values):
    config = RunConfig.of(values)
    assert RunConfig.of(read_config(written(tmp_path, config.to_toml()))) == config
    assert config.given == values.keys()
    printed = run_tokt("run", *command_line(values), "--print-config")
    assert (printed.code, printed.err) == (0, "") and printed.out == config.to_toml()
    again = run_tokt("run", "--config", written(tmp_path, printed.out), "--print-config")
    assert again.out == printed.out


def test_a_printed_run_shows_every_option():
    printed = RunConfig().to_toml()
    assert not any(tomllib.loads(printed).values())
    for option in OPTIONS.values():
        assert re.search(rf"^# {option.key} = .+  # \S", printed, re.MULTILINE)
    # With the comment signs away, the defaults are those of the fields.
    lines = [
        line.removeprefix("# ")
        for line in printed.splitlines()
        if re.match(r"# [a-z-]+ = [^.<A-Zu]", line) or line.startswith("[")
    ]
    for section, table in tomllib.loads("\n".join(lines)).items():
        for key, value in table.items():
            name = key.replace("-", "_")
            assert OPTIONS[name].section == section and OPTIONS[name].default == value


@settings(max_examples=scaled(60))
@given(file=some_options, line=some_options)
def test_the_command_line_wins_over_the_file(file, line):
    config = RunConfig.of(file, line)
    for name in file.keys() | line.keys():
        if name in line:
            assert config.value(name) == line[name]
        elif line.keys() & set(OPTIONS[name].not_with):
            # A bundle on the command line wins over the file's store.
            assert config.value(name) is None and name not in config.given
        else:
            assert config.value(name) == file[name]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[outputs]\nhartbeat = 1", "'outputs.hartbeat': did you mean outputs.heartbeat?"),
        ("[source]\npixel_format = 'Mono8'", "did you mean source.pixel-format?"),
        ("[policy]\nlog-keep = 1", "'policy.log-keep': did you mean recording.log-keep?"),
        ("[otputs]\nformat = 'v2'", "unknown table 'otputs': did you mean outputs?"),
        ("rate = 5", "unknown key 'rate': did you mean source.rate?"),
        ("source = 'dive'", "did you mean source.source?"),
        ("[source]\nrate = 'fast'", "source.rate is a number, not text in quotes"),
        ("[source]\nptp = 1", "source.ptp is true or false, not a whole number"),
        ("[recording]\nlog-keep = true", "log-keep is a whole number, not true or false"),
        ("[recording]\nlog-keep = 2.0", "log-keep is a whole number, not a number"),
        ("[monitoring]\nmetrics = 9105", "metrics is text in quotes, not a whole number"),
        ("[outputs]\nudp = 'a:1'", "udp is a list of text in quotes, not text in quotes"),
        ("[outputs]\nudp = [['a:1']]", "udp is a list of text in quotes, not a list"),
        ("[model.store]\nx = 1", "model.store is a path in quotes, not a table"),
        ("[model]\nstore = 2016-04-20", "model.store is a path in quotes, not date"),
        ('[model]\nstore = "a\\u0000b"', "too large, or text with a NUL"),
        (f"[source]\nrate = {'9' * 400}", "source.rate is too large"),
        (f"[recording]\nlog-keep = 0x{'f' * 9000}", "recording.log-keep is too large"),
        (f"[source]\nrate = {'9' * 5000}", "digits"),
        ("[source", "dive.toml"),
        ("[source]\nsource = 1\nsource = 2", "dive.toml"),
        ("x = " + "[" * 5000, "dive.toml"),
    ],
)
def test_a_mistake_in_a_file_is_one_line(tmp_path, content, message):
    said = refused(message, "run", "--config", written(tmp_path, content + "\n"))
    assert said.startswith("tokt: error: config ") and said.count("\n") == 1


def test_a_file_that_cannot_be_read_is_one_line(tmp_path):
    binary = tmp_path / "b.toml"
    binary.write_bytes(b"\xff")
    for path, message in ((tmp_path / "none", "No such file"), (binary, "not UTF-8 text")):
        assert refused(message, "run", "--config", path).count("\n") == 1
    refused("no configuration file holds it", "run", "--store=\udcff", "--print-config")


@settings(max_examples=scaled(100), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    section=st.sampled_from([*SECTIONS, "x"]),
    key=st.sampled_from([option.key for option in OPTIONS.values()]) | st.text("ab-_.", max_size=5),
    value=st.sampled_from(["1", "-1.5", "inf", "nan", "true", "''", "[]", "[1, 'a']", "{a = 1}"])
    | st.text(max_size=5),
)
def test_any_file_is_read_or_refused(tmp_path, section, key, value):
    path = tmp_path / "any.toml"
    path.write_bytes(f"[{section}]\n{key} = {value}\n".encode("utf-8", "surrogatepass"))
    try:
        config = RunConfig.of(read_config(path))
    except ToktError:
        return
    assert len(config.given) == 1 and config.to_toml()


def test_the_sample_of_the_docs_is_a_run():
    config = RunConfig.of(read_config(DIVE))
    check_options(config)
    assert {option.section for option in OPTIONS.values() if option.name in config.given} >= {
        *("source", "model", "stereo", "outputs", "recording")
    }
    (block,) = re.findall(r"```toml\n(.*?)```", (DOCS / "install.md").read_text(), re.DOTALL)
    whole = tomllib.loads(DIVE.read_text())
    for section, table in tomllib.loads(block).items():
        assert table.items() <= whole[section].items()
    assert "--config /srv/tokt/dive.toml" in (DOCS / "tokt.service").read_text()


def test_options_of_a_file_that_would_do_nothing_are_refused(tmp_path):
    """Whether they are the defaults or not, as on the command line."""
    content = "[source]\nsource = 'dive'\n[outputs]\nheartbeat = 0.5\n"
    asked = ("run", "--config", written(tmp_path, content))
    refused("--heartbeat is for live cameras, or recorded", *asked)
    refused("unknown source 'dive'", *asked, "--rate", "5", "--model", "waters")


def test_a_start_says_every_option_that_verdicts_depend_on(tmp_path):
    poses = tmp_path / "poses.csv"
    poses.write_text("")
    config = RunConfig.of(
        {"source": "dive", "store": tmp_path, "policy": "either", "threads": 2, "anchor": 0.1}
        | {"moving": "none"}
        | {"stereo": "pushbroom", "odometry": poses, "calibration": poses, "record": Path("rec")}
        | {"pixel_format": "Mono8", "stale": 0.3}
    )
    start = RunStart.of(config, source="/dive")
    assert {option.logged for option in OPTIONS.values()} - {""} <= start.fields().keys()
    assert start.moving == "none"
    assert (start.source, start.policy, start.threads, start.anchor) == ("/dive", "either", 2, 0.1)
    assert (start.stereo_way, start.stereo_scale, start.record) == ("pushbroom", 0.5, "rec")
    assert start.odometry == start.calibration and start.models_from == str(tmp_path)
    assert (start.limits.stale_s, start.pixel_format) == (0.3, "Mono8")
    without = RunStart.of(RunConfig.of({"source": "dive"}))
    assert without == RunStart("dive", "fallback")


def test_a_run_without_a_file_imports_no_parser_of_one():
    """After a crash each import is time in which nothing is said."""
    program = (
        "import sys; sys.argv = ['tokt', 'run']\n"
        "from tokt.cli import main\n"
        "try: main()\n"
        "except SystemExit: print(*{'tomllib', 'difflib', 'numpy', 'cv2'} & {*sys.modules})"
    )
    done = run_python("-c", program)
    assert done.stdout.split() in ([], ["difflib"]), done.stderr  # typer imports difflib
