"""`tokt run`: the runtime at sea."""

from __future__ import annotations

import sys

import typer

from . import run_options as options
from .output import print_json, say

_WATCHDOG = "--watchdog"


def run(
    context: typer.Context,
    source: options.SourceOption,
    store: options.StoreOption = None,
    bundle: options.BundleOption = None,
    frames: options.FramesOption = None,
    calibration: options.CalibrationOption = None,
    stereo: options.StereoOption = "bm",
    stereo_scale: options.StereoScaleOption = 0.5,
    odometry: options.OdometryOption = None,
    policy: options.PolicyOption = "fallback",
    anchor: options.AnchorOption = None,
    udp: options.UdpOption = None,
    format_: options.FormatOption = "v1",
    mavlink: options.MavlinkOption = None,
    camera_fov_deg: options.CameraFovOption = None,
    mavlink_assumed_m: options.MavlinkAssumedOption = 1.0,
    mavlink_system: options.MavlinkSystemOption = 1,
    mavlink_component: options.MavlinkComponentOption = 196,
    mavlink_messages: options.MavlinkMessagesOption = "both",
    mavlink_unknown: options.MavlinkUnknownOption = "silence",
    rate: options.RateOption = None,
    threads: options.ThreadsOption = 1,
    pixel_format: options.PixelFormatOption = None,
    exposure_us: options.ExposureOption = None,
    gain_db: options.GainOption = None,
    packet_size: options.PacketSizeOption = None,
    bandwidth: options.BandwidthOption = None,
    camera_rate: options.CameraRateOption = None,
    trigger: options.TriggerOption = None,
    ptp: options.PtpOption = False,
    wait: options.WaitOption = False,
    stale: options.StaleOption = 0.5,
    heartbeat: options.HeartbeatOption = 0.5,
    watchdog: options.WatchdogOption = False,
    log: options.LogOption = None,
    log_values: options.LogValuesOption = False,
    log_max_mb: options.LogMaxOption = 100.0,
    log_keep: options.LogKeepOption = 20,
    metrics: options.MetricsOption = None,
    record: options.RecordOption = None,
    record_mb: options.RecordMaxOption = 10_000.0,
    record_before: options.RecordBeforeOption = 2.0,
    record_after: options.RecordAfterOption = 2.0,
    shadow: options.ShadowOption = None,
    shadow_log: options.ShadowLogOption = None,
    as_json: options.JsonSummaryOption = False,
) -> None:
    """Judge every frame of a source and send the verdicts."""
    from .run_asked import Asked
    from .run_setup import carry_out

    given = frozenset(name for name in context.params if _is_written(context, name))
    asked = Asked(**{name: value for name, value in locals().items() if name in Asked.names()})
    if watchdog:
        raise typer.Exit(_watched(source))
    done = carry_out(asked)
    say(done.words())
    if as_json:
        print_json(done.to_json())


def _is_written(context: typer.Context, name: str) -> bool:
    """Whether an option is on the command line, be it with its default value."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _watched(source: str) -> int:
    """Run the same command under a watchdog; its exit code."""
    from ..features.errors import ToktError
    from ..inference.clock import SYSTEM_CLOCK
    from ..inference.frame_stream import is_stream_source
    from ..inference.interrupt import stop_on_signal
    from ..inference.notify import Notifier
    from ..inference.watchdog import Watchdog

    if is_stream_source(source):
        raise ToktError("--watchdog is not for a stream, which may wait as long as it likes")
    arguments = [argument for argument in sys.argv[1:] if argument != _WATCHDOG]
    command = [sys.executable, "-P", "-m", "tokt", *arguments]
    dog = Watchdog(command, lambda line: say(f"watchdog: {line}"), Notifier(SYSTEM_CLOCK))
    with stop_on_signal(dog.stop):
        return dog.run()
