"""`tokt run` and `tokt listen`: the runtime at sea, and a look at what it sends."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..features.errors import ToktError
from .output import print_json, say

if TYPE_CHECKING:
    from ..inference.assemble import Stereo
    from ..inference.detector import PatchScorer
    from ..inference.runtime import Summary
    from ..inference.udp import UdpSender
    from ..models.bundle import Bundle

_FORMATS = {"v1": 1, "v2": 2}
_STATUS_WORDS = {1: "obstacle", 0: "clear", -1: "unknown"}


def run(
    source: Annotated[str, typer.Option(help="A folder of frames or a video file.")],
    store: Annotated[Path | None, typer.Option(help="Run the active model of a store.")] = None,
    bundle: Annotated[Path | None, typer.Option(help="Run the model in this file.")] = None,
    frames: Annotated[
        str | None, typer.Option(help="Which frames, such as 61-80,141-160. Default: all.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="Stereo calibration file, for disparity.")
    ] = None,
    stereo: Annotated[
        str,
        typer.Option(
            help="How pairs are looked at: bm (block matching), sgbm (semi-global, slower), or "
            "pushbroom (a few distances only, fastest)."
        ),
    ] = "bm",
    stereo_scale: Annotated[
        float, typer.Option(help="Size of the views that are matched, over the frames'.")
    ] = 0.5,
    odometry: Annotated[
        Path | None,
        typer.Option(help="Poses by frame (CSV), by which pushbroom carries what it saw along."),
    ] = None,
    policy: Annotated[
        str, typer.Option(help="texture, disparity, either or fallback.")
    ] = "fallback",
    udp: Annotated[
        list[str] | None,
        typer.Option(help="HOST:PORT to send to; may be repeated. Default: 127.0.0.1:1130."),
    ] = None,
    format_: Annotated[
        str, typer.Option("--format", help="Datagrams: v1 (LabVIEW) or v2 (JSON).")
    ] = "v1",
    rate: Annotated[
        float | None, typer.Option(help="Frames per second. Default: as fast as they come.")
    ] = None,
    threads: Annotated[int, typer.Option(help="Threads that share one frame's patches.")] = 1,
    pixel_format: Annotated[
        str | None,
        typer.Option(
            help="Gray images hold a camera's raw pixels: Mono8, BayerRG8, BayerGR8, BayerGB8 "
            "or BayerBG8."
        ),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Add one JSON object a frame to this file.")
    ] = None,
    log_values: Annotated[
        bool, typer.Option("--log-values", help="Log each patch's decision values too.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a summary as one JSON object at the end.")
    ] = False,
) -> None:
    """Judge every frame of a source and send the verdicts."""
    from ..features.mission import parse_frames
    from ..inference.assemble import build_policy
    from ..inference.clock import SYSTEM_CLOCK
    from ..inference.interrupt import stop_on_signal
    from ..inference.log import JsonLines
    from ..inference.runtime import Runtime
    from ..inference.sources import open_source

    if log_values and log is None:
        raise ToktError("--log-values needs a log to write them to (--log FILE.jsonl)")
    chosen = None if frames is None else parse_frames(frames)
    pairs = _stereo(calibration, stereo, stereo_scale, odometry)
    frames_in = open_source(source, SYSTEM_CLOCK, chosen, rate, pairs is not None, pixel_format)
    loaded: list[Bundle] = []
    load = _remembering(_model_loader(store, bundle), loaded)
    built = build_policy(policy, load, pairs, threads)
    with ExitStack() as opened:
        senders = _open_senders(udp, format_, opened)
        log_file = None if log is None else opened.enter_context(closing(JsonLines(log)))
        runtime = Runtime(frames_in, built, senders, SYSTEM_CLOCK, log_file, log_values)
        for model in loaded:
            say(_rule_line(model))
        with stop_on_signal(frames_in.stop):
            summary = runtime.run()
    say(_summary_line(summary, senders))
    if as_json:
        print_json({"policy": policy, "format": format_, **_rule_json(loaded), **summary.to_json()})


def _stereo(
    calibration: Path | None, way: str, scale: float, odometry: Path | None
) -> Stereo | None:
    """How pairs are looked at, or None without a calibration."""
    from ..inference.assemble import Stereo
    from ..inference.matching import BM
    from ..inference.odometry import load_odometry
    from ..inference.rectify import HALF
    from .stereo_file import read_calibration_file

    if calibration is None:
        if (way, scale, odometry) != (BM, HALF, None):
            raise ToktError("stereo needs a calibration (--calibration FILE.yml)")
        return None
    poses = None if odometry is None else load_odometry(odometry)
    return Stereo(read_calibration_file(calibration), way, scale, poses)


def _remembering(
    load: Callable[[], Bundle] | None, loaded: list[Bundle]
) -> Callable[[], PatchScorer] | None:
    """The same loader, which adds its model to `loaded`."""
    if load is None:
        return None

    def load_and_remember() -> PatchScorer:
        loaded.append(load())
        return loaded[0]

    return load_and_remember


def _rule_line(bundle: Bundle) -> str:
    rule = bundle.operating_point.rule
    late = f"; {rule.latency_words()}" if rule.latency_frames else ""
    return f"model {bundle.label}: status 1 with {rule.words()}{late}"


def _rule_json(loaded: list[Bundle]) -> dict[str, Any]:
    """What the summary says of the frame rule; None without a model."""
    rule = loaded[0].operating_point.rule if loaded else None
    return {
        "model": loaded[0].label if loaded else None,
        "frame_rule": rule and rule.to_json(),
        "latency_frames": rule and rule.latency_frames,
    }


def _model_loader(store: Path | None, bundle: Path | None) -> Callable[[], Bundle] | None:
    if store is not None and bundle is not None:
        raise ToktError("give --store or --bundle, not both")
    if store is not None:
        from ..models.store import Store

        return Store(store).active
    if bundle is not None:
        from ..models.bundle import read_bundle

        return lambda: read_bundle(bundle)
    return None


def _open_senders(udp: list[str] | None, format_: str, opened: ExitStack) -> list[UdpSender]:
    from ..inference.udp import DEFAULT_HOST, DEFAULT_PORT, UdpSender, parse_address

    if format_ not in _FORMATS:
        raise ToktError(f"unknown format {format_!r} (choose from {', '.join(_FORMATS)})")
    senders = []
    for address in udp or [f"{DEFAULT_HOST}:{DEFAULT_PORT}"]:
        sender = UdpSender(*parse_address(address), _FORMATS[format_])
        senders.append(opened.enter_context(closing(sender)))
    return senders


def _summary_line(summary: Summary, senders: list[UdpSender]) -> str:
    line = (
        f"{summary.frames} frames in {summary.seconds:.1f} s: {summary.obstacle} obstacle, "
        f"{summary.clear} clear, {summary.unknown} unknown; {summary.sent} datagrams sent"
    )
    if summary.send_failures:
        reasons = sorted({sender.last_error for sender in senders if sender.last_error})
        line += f", {summary.send_failures} refused ({', '.join(reasons)})"
    if summary.log_failures:
        line += f"; {summary.log_failures} log lines could not be written"
    return line


def listen(
    port: Annotated[int, typer.Option(help="UDP port to listen on.", min=1, max=65535)] = 1130,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    count: Annotated[
        int | None, typer.Option(help="Stop after this many datagrams.", min=1)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a datagram.")] = False,
) -> None:
    """Show the datagrams that arrive, one line each, until Ctrl-C."""
    from ..inference.interrupt import stop_on_signal
    from ..inference.listen import datagrams

    received = 0
    interrupted: list[bool] = []

    def stopped() -> bool:
        return bool(interrupted) or received == count

    def ready() -> None:
        say(f"listening on {host}:{port}; Ctrl-C ends")

    with stop_on_signal(lambda: interrupted.append(True)):
        for sender, data in datagrams(host, port, stopped, ready):
            received += 1
            try:
                print(_datagram_line(sender, data, as_json), flush=True)
            except BrokenPipeError:
                # Who read has gone (| head -1). What Python still flushes at its end has to go
                # somewhere, or it complains.
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                return


def _datagram_line(sender: str, data: bytes, as_json: bool) -> str:
    from ..inference.udp import decode

    try:
        fields = decode(data)
    except ToktError as error:
        fields = {"error": str(error), "bytes": len(data)}
    if as_json:
        return json.dumps({"from": sender, **fields}, allow_nan=False)
    return f"{sender}  {_words(fields)}"


def _words(fields: dict[str, Any]) -> str:
    """One line for people; what came over the network cannot move the cursor."""
    if "error" in fields:
        return f"{fields['error']} ({fields['bytes']} bytes)"
    words = [f"v{fields['v']}", _STATUS_WORDS[fields["status"]]]
    words += [
        f"{name}={value}"
        for name, value in fields.items()
        if name not in ("v", "status") and value is not None
    ]
    return "".join(char if char.isprintable() else "?" for char in "  ".join(words))
