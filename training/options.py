"""Functions of one options dataclass, which are called with it or with its fields."""

from collections.abc import Callable, Sequence
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar, cast, overload

from tokt.features.common.errors import ToktError

Fields = ParamSpec("Fields")
Options = TypeVar("Options")
Given = TypeVar("Given", contravariant=True)
Result = TypeVar("Result", covariant=True)
Notice = Callable[[str], None]
"""Is told what a user should know of the work; `warnings.warn` unless something else is given."""
PathOrText = Path | str
OneOrMore = PathOrText | Sequence[PathOrText] | None
"""A path, several, or none."""


class Taking(Protocol[Fields, Given, Result]):
    """A function of options; ``train(TrainOptions("tower"))`` is ``train("tower")``."""

    @overload
    def __call__(self, options: Given, /, **callbacks: Callable[..., Any]) -> Result: ...
    @overload
    def __call__(self, *args: Fields.args, **fields: Fields.kwargs) -> Result: ...


def takes(
    kind: Callable[Fields, Options],
) -> Callable[[Callable[..., Result]], Taking[Fields, Options, Result]]:
    """Let a function whose first argument is a `kind` be called with the fields of one instead."""

    def decorated(function: Callable[..., Result]) -> Taking[Fields, Options, Result]:
        @wraps(function)
        def called(*args: Any, **fields: Any) -> Result:
            if args and isinstance(args[0], cast(type, kind)):
                return function(*args, **fields)
            return function(kind(*args, **fields))

        given = signature(kind).replace(return_annotation=signature(function).return_annotation)
        called.__signature__ = given  # type: ignore[attr-defined]
        return cast(Taking[Fields, Options, Result], called)

    return decorated


def at_least(options: object, **bounds: int) -> None:
    """Raise ToktError where a field is below its bound, to which typer holds a command line."""
    for name, least in bounds.items():
        value = getattr(options, name)
        if value is not None and value < least:
            raise ToktError(f"--{name.replace('_', '-')} is at least {least}, not {value}")


def paths(given: OneOrMore) -> list[Path]:
    """The paths, however they were given; ToktError where one is something else."""
    for one in () if isinstance(given, str | Path) else given or ():
        if not isinstance(one, str | Path):
            raise ToktError(
                f"a path is text or a Path, not {type(one).__name__}. Labels go into a file first: "
                'labels.write("labels.csv")'
            )
    return [Path(text) for text in texts(given)]


def texts(given: OneOrMore) -> list[str]:
    """The texts, however they were given: one, several or none."""
    return [str(one) for one in ([given] if isinstance(given, str | Path) else given or ())]
