"""`tokt listen`: a look at what the runtime sends."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from tokt.cli.output import say


def listen(
    port: Annotated[int, typer.Option(help="UDP port to listen on.", min=1, max=65535)] = 1130,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    count: Annotated[
        int | None, typer.Option(help="Stop after this many datagrams.", min=1)
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(help="Say when nothing came for so many seconds.", min=0.1, max=86400),
    ] = None,
    json_lines: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Show the datagrams that arrive, one line each, until Ctrl-C.

    v2 numbers its datagrams: those that are missing are counted, for each sender by itself.
    """
    from tokt.cli.interrupt import stop_on_signal
    from tokt.inference.clock import SYSTEM_CLOCK
    from tokt.inference.outputs.listen import ReceivedDatagram, SenderMonitor, as_json, as_words
    from tokt.inference.outputs.listen import listen as heard_on

    received = 0
    interrupted: list[bool] = []
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
        say(f"{watch.lost} datagrams are missing")
