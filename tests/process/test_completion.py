"""Completion in shells: the script that tokt prints, what it answers, keys typed at a real bash."""

import os
import pty
import shutil
import subprocess
import sys

import pytest

from tests.calls import succeeds

ALIASES = ("tiny-lbp@challenger", "tiny-lbp@champion")
PROGRAM = f"#!{sys.executable}\nfrom tokt.cli.app import main\n\nmain()\n"
CALL = """
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1))
_tokt_completion tokt
printf '%s\\n' "${COMPREPLY[@]}"
"""
RAN = "tokt() { printf 'ran:%s\\n' \"$*\"; }\n"
"""What is typed at the terminal; completion calls the program itself."""


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Where the program is called tokt, as its completion has to know it."""
    folder = tmp_path_factory.mktemp("bin")
    (folder / "tokt").write_text(PROGRAM)
    (folder / "tokt").chmod(0o755)
    path = os.pathsep.join([str(folder), os.environ["PATH"]])
    known = {name: value for name, value in os.environ.items() if name != "MLFLOW_TRACKING_URI"}
    return {**known, "PATH": path, "TERM": "dumb", "HOME": str(folder)}


@pytest.fixture(scope="module")
def script(environment):
    return said(environment, "bash", "-c", "tokt --show-completion; :")


@pytest.fixture(scope="module")
def folder(trained, tmp_path_factory):
    """A folder with a workspace, in which a model has an alias, and with a file."""
    made = tmp_path_factory.mktemp("folder")
    shutil.copytree(trained, made / ".tokt")
    succeeds("models", "alias", "tiny-lbp/1", "champion", "--workspace", made / ".tokt")
    (made / "file.tokt").touch()
    return made


def said(environment, *command, **more):
    done = subprocess.run(command, env=environment, capture_output=True, text=True, **more)
    assert not done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("dep",), ["deploy", "depth"]),
        (("train", "t"), ["tiny"]),
        (("evaluate", "ti"), ["tiny-lbp", "tiny-lbp/1", *ALIASES]),
        (("train", "tiny", "--preset", "l"), ["lite", "lite_water"]),
        (("train", "tiny", "--preset", "=", "w"), ["water"]),
        (("run", "--policy", "d"), ["disparity"]),
        (("run", "--calibration", ""), [""]),
    ],
)
def test_bash_completes(words, found, environment, script, folder):
    command = ("bash", "-c", script + CALL, "bash", "tokt", *words)
    assert said(environment, *command, cwd=folder).split("\n")[:-1] == found


@pytest.mark.parametrize(
    ("typed", "ran"),
    [
        ("tokt deploy tiny-lbp@cham", "deploy tiny-lbp@champion"),
        ("tokt train tiny --preset=th", "train tiny --preset=thesis"),
        ("tokt export tiny-lbp -o fi", "export tiny-lbp -o file.tokt"),
    ],
)
def test_keys_typed_at_bash(typed, ran, environment, script, folder, tmp_path):
    (tmp_path / "script").write_text(script + "\n" + RAN)
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.execvpe("bash", ["bash", "--rcfile", str(tmp_path / "script"), "-i"], environment)
    os.write(terminal, f"{typed}\t\nexit\n".encode())
    shown = b""
    try:
        while part := os.read(terminal, 4096):
            shown += part
    except OSError:  # bash has ended
        os.close(terminal)
    os.waitpid(child, 0)
    assert f"ran:{ran}\r\n" in shown.decode()


@pytest.mark.parametrize("shell", ["zsh", "fish", "powershell"])
def test_other_shells_are_answered(shell, environment, folder):
    # The shell that calls is not this one: Typer is told, for its own tests, not to look.
    named = {**environment, "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    assert "complete" in said(named, "tokt", "--show-completion", shell).lower()
    asked = {
        "_TOKT_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": "tokt deploy tiny-lbp@",
        "_TYPER_COMPLETE_WORD_TO_COMPLETE": "tiny-lbp@",
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    assert "tiny-lbp@champion" in said({**environment, **asked}, "tokt", cwd=folder)


def test_names_are_completed_without_what_takes_long_to_import(environment, folder):
    asked = {"_TOKT_COMPLETE": "complete_bash", "COMP_CWORD": "2", "PYTHONPROFILEIMPORTTIME": "1"}
    for words in ("tokt\ntrain\nti", "tokt\nevaluate\nti"):
        told = {**environment, **asked, "COMP_WORDS": words}
        done = subprocess.run(["tokt"], env=told, capture_output=True, text=True, cwd=folder)
        assert done.stdout.startswith("tiny")
        imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
        assert "tokt.cli.app" in imported
        assert not {"numpy", "cv2", "mlflow", "pandas", "rich", "sqlalchemy"} & imported
