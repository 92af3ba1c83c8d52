"""ToktError, the one error that a user's own input can cause."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

MAX_MESSAGE = 800
"""Characters. Files may hold names of any length: of a longer message the middle is left out."""
_CUT = " ... "


class ToktError(Exception):
    """Something the user gave cannot be used; the message is one line, in the user's words.

    The command line prints it as ``tokt: error: MESSAGE`` and exits with code 2. Programming
    mistakes raise the usual built-in exceptions instead: exit code 70, and the traceback in a file.

    Parameters
    ----------
    message : str
        The one line. Much of what it quotes comes out of files: what cannot be printed is
        escaped, and what is too long is cut. So no file moves a cursor or fills a log.
    """

    def __init__(self, message: str) -> None:
        # Cut before it is escaped and, grown by that, after it.
        super().__init__(_cut(printable(" ".join(_cut(message).splitlines()))))


class UnavailableError(ToktError):
    """Something that the system refuses at present, such as a port; it may grant it later."""


class FrameError(ToktError):
    """One frame cannot be read. A mission goes on without it; the runtime calls it unknown."""


def check_format(version: Any, newest: int, what: str) -> None:
    """Check the version of a file's format; ValueError if it is none, ToktError if it is newer."""
    if type(version) is not int or version < 1:
        raise ValueError(f"{version!r} is no version of a format")
    if version > newest:
        raise ToktError(
            f"{what} has format {version}, newer than this tokt reads ({newest}); update tokt"
        )


@contextmanager
def naming(where: object) -> Iterator[None]:
    """Say where it is, such as in which file, before what a ToktError says is wrong there."""
    try:
        yield
    except ToktError as error:
        error.args = ToktError(f"{where}: {error}").args  # whatever kind of error it is
        raise


@contextmanager
def os_errors_as(what: str, kind: type[ToktError] = UnavailableError) -> Iterator[None]:
    """Turn what the system refuses into an error of one line: ``WHAT: No such file``."""
    try:
        yield
    except OSError as error:
        raise kind(f"{what}: {os_words(error)}") from None


def os_words(error: OSError) -> str:
    """Why the system refused, without the file's name."""
    return error.strerror or str(error)


def printable(text: str) -> str:
    r"""The text on one line that a terminal shows as it is.

    What moves a cursor, breaks a line, turns the direction of writing or cannot be seen stands as
    its escape, such as ``\x1b``: no name or reason out of a file looks like something else.
    """
    return text if text.isprintable() else "".join(map(_printable, text))


def counted(number: int, what: str) -> str:
    """The number and what it counts: ``1 frame``, ``2 frames``, ``2 patches``."""
    many = "es" if what.endswith("ch") else "s"
    return f"{number} {what}{'' if number == 1 else many}"


def _cut(text: str) -> str:
    if len(text) <= MAX_MESSAGE:
        return text
    head = MAX_MESSAGE * 3 // 4
    return text[:head] + _CUT + text[len(text) - (MAX_MESSAGE - head - len(_CUT)) :]


def _printable(sign: str) -> str:
    if sign.isprintable():
        return sign
    blank = sign.isspace() and sign.splitlines() == [sign]
    return " " if blank else sign.encode("unicode_escape").decode("ascii")


OK, NOTE, FAULT = "ok", "note", "fault"


@dataclass(frozen=True)
class Finding:
    """One line of `tokt doctor`."""

    name: str  # what was looked at
    state: str  # OK; NOTE: worth knowing, perhaps as intended; FAULT: something does not work
    text: str  # what was found, for people
    figures: dict[str, Any] = field(default_factory=dict)  # the same for scripts, as JSON values

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {**self.figures, "name": self.name, "state": self.state, "text": self.text}
