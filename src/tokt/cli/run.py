"""`tokt run`, the runtime at sea, and `tokt listen`, a look at what it sends."""

import gc
import os
import sys
from collections.abc import Callable
from functools import partial
from inspect import Parameter, signature
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from tokt.features.common.errors import ToktError, counted
from tokt.features.common.terminal import real_stderr, say, stop_on_signal
from tokt.inference.config import OPTIONS, RunConfig, read_config

from .options import is_written


def run(
    context: typer.Context,
    config: Annotated[
        Path | None, Option(help="Options from a TOML file; the command line wins.")
    ] = None,
    print_config: Annotated[
        bool, Option("--print-config", help="Print the options as such a file, and do not run.")
    ] = False,
    **values: Any,
) -> Callable[[], None] | None:
    """Judge every frame of a source and send the verdicts."""
    from tokt.inference.assembly.held_run import take_over

    options = take_over()
    if options is None:
        written = {name: value for name, value in values.items() if is_written(context, name)}
        options = RunConfig.of({} if config is None else read_config(config), written)
    if print_config:
        print(options.to_toml(), end="")
        return None
    if not options.source.source:
        raise ToktError("Missing option '--source'.")
    if options.monitoring.watchdog:
        raise typer.Exit(_watched(options, config))
    # Called once the command line is done with: below its many frames imports take longer.
    return partial(_run_to_its_end, options)


def _run_to_its_end(options: RunConfig) -> None:
    # What is imported stays: going through it for garbage takes a thirtieth of a start.
    gc.disable()
    from tokt.inference.assembly.run import run as run_to_its_end

    gc.freeze()
    gc.enable()
    run_to_its_end(options)


def _options() -> list[Parameter]:
    """Those of `tokt.inference.config`, as typer takes them."""
    made = []
    for each in OPTIONS.values():
        names = f"--{each.key}/--no-{each.key}" if each.kind is bool else f"--{each.key}"
        about = Option(
            *(names,),
            help=each.text,
            metavar=each.metavar or None,
            show_default=each.kind is not bool,
            rich_help_panel=each.section.capitalize(),
        )
        default = None if each.default == "" else each.default
        kind: Any = Annotated[each.annotation, about]
        made.append(Parameter(each.name, Parameter.KEYWORD_ONLY, default=default, annotation=kind))
    return made


_own = signature(run, eval_str=True)
_named = [each for each in _own.parameters.values() if each.kind is not Parameter.VAR_KEYWORD]
run.__signature__ = _own.replace(parameters=[*_named, *_options()])  # type: ignore[attr-defined]


def _watched(options: RunConfig, config_file: Path | None) -> int:
    """Run the same command under a watchdog; its exit code."""
    from tokt.inference.assembly.held_run import HeldRun
    from tokt.inference.clock import SYSTEM_CLOCK
    from tokt.inference.monitoring.watchdog import Notifier, Watchdog
    from tokt.inference.sources.stream import is_stream_source

    if is_stream_source(options.source.source):
        raise ToktError("--watchdog is not for a stream, which may wait as long as it likes")
    # The last one wins, over a file as well.
    command = [sys.executable, "-P", "-m", "tokt", *sys.argv[1:], "--no-watchdog"]
    notifier = Notifier(SYSTEM_CLOCK)
    dog = Watchdog(
        command=command,
        say=lambda line: say(f"watchdog: {line}"),
        notifier=notifier,
        stderr=real_stderr(),
        beginning=HeldRun.of(options, config_file).to_bytes,
    )
    with stop_on_signal(dog.stop):
        return dog.run()


def listen(
    port: Annotated[int, Option(help="UDP port to listen on.", min=1, max=65535)] = 1130,
    host: Annotated[str, Option(help="Address to listen on.")] = "127.0.0.1",
    count: Annotated[int | None, Option(help="Stop after this many datagrams.", min=1)] = None,
    timeout: Annotated[
        float | None,
        Option(
            help="Tell when nothing came for so many seconds. Default: 1; with --json never.",
            min=0.1,
            max=86400,
        ),
    ] = None,
    json_lines: Annotated[bool, Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Show the datagrams that arrive, a line each, until Ctrl-C.

    Silence is unknown: v1 has no other word for it, and sends nothing then. v2 numbers its
    datagrams: the missing ones are counted, for each sender by itself.
    """
    from tokt.inference.clock import SYSTEM_CLOCK
    from tokt.inference.outputs.listen import (
        DEFAULT_TIMEOUT_S,
        ReceivedDatagram,
        SenderMonitor,
        as_json,
        as_words,
    )
    from tokt.inference.outputs.listen import listen as heard_on

    received = 0
    interrupted: list[bool] = []
    if timeout is None and not json_lines:
        timeout = DEFAULT_TIMEOUT_S
    watch = SenderMonitor(SYSTEM_CLOCK.monotonic(), timeout)

    def stopped() -> bool:
        return bool(interrupted) or received == count

    def ready() -> None:
        say(f"listening on {host}:{port}; Ctrl-C ends")

    with stop_on_signal(lambda: interrupted.append(True)):
        for event in heard_on(host, port, watch, SYSTEM_CLOCK, stopped, ready):
            received += isinstance(event, ReceivedDatagram)
            try:
                print(as_json(event) if json_lines else as_words(event), flush=True)
            except BrokenPipeError:
                # Who read has gone (| head -1). What Python still flushes at its end has to go
                # somewhere, or it complains.
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return
    if watch.lost:
        say(f"missing: {counted(watch.lost, 'datagram')}")
