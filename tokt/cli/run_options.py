"""The options of `tokt run`, by what they are about."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SourceOption = Annotated[
    str,
    typer.Option(
        help="A folder of frames, a video file, or live cameras: pymba:ID or genicam:ID, with "
        "two IDs for the left and the right one: pymba:ID,ID. "
        "Or stream:HOST:PORT, frames of another program (docs/closed_loop.md)."
    ),
]
StoreOption = Annotated[
    Path | None,
    typer.Option(help="Run the active model of a store, and go over to the next one by itself."),
]
BundleOption = Annotated[Path | None, typer.Option(help="Run the model in this file.")]
FramesOption = Annotated[
    str | None, typer.Option(help="Which frames, such as 61-80,141-160. Default: all.")
]
CalibrationOption = Annotated[
    Path | None, typer.Option(help="Stereo calibration file, for disparity.")
]
StereoOption = Annotated[
    str,
    typer.Option(
        help="How pairs are looked at: bm (block matching), sgbm (semi-global, slower), or "
        "pushbroom (a few distances only, fastest)."
    ),
]
StereoScaleOption = Annotated[
    float, typer.Option(help="Size of the views that are matched, over the frames'.")
]
OdometryOption = Annotated[
    Path | None,
    typer.Option(help="Poses by frame (CSV), by which pushbroom carries what it saw along."),
]
PolicyOption = Annotated[str, typer.Option(help="texture, disparity, either or fallback.")]
ThreadsOption = Annotated[int, typer.Option(help="Threads that share one frame's patches.")]
RateOption = Annotated[
    float | None,
    typer.Option(
        help="Replay in real time, so many frames per second: frames that there is no time for "
        "are left out. Default: each frame, as fast as they come."
    ),
]
PixelFormatOption = Annotated[
    str | None,
    typer.Option(
        help="Of live cameras: what they are set to. Of image files: gray ones hold a camera's "
        "raw pixels, Mono8, BayerRG8, BayerGR8, BayerGB8 or BayerBG8."
    ),
]
AnchorOption = Annotated[
    float | None,
    typer.Option(
        metavar="SIZE",
        help="Share of the frame that an object is to cover, such as 0.1: v2 and the log then say "
        "how far it is from that, and from the centre.",
    ),
]

UdpOption = Annotated[
    list[str] | None,
    typer.Option(
        help="HOST:PORT to send to, or v1@HOST:PORT, v2@HOST:PORT; may be repeated. Default: "
        "127.0.0.1:1130."
    ),
]
FormatOption = Annotated[
    str, typer.Option("--format", help="Datagrams: v1 (LabVIEW) or v2 (JSON).")
]
MavlinkOption = Annotated[
    list[str] | None,
    typer.Option(metavar="udpout:HOST:PORT", help="Also send MAVLink there; may be repeated."),
]
CameraFovOption = Annotated[
    float | None,
    typer.Option(help="The left camera's horizontal field of view in water, degrees; MAVLink."),
]
MavlinkAssumedOption = Annotated[
    float, typer.Option(help="Metres to an obstacle whose distance nothing measured; MAVLink.")
]
MavlinkSystemOption = Annotated[int, typer.Option(help="MAVLink's system number of the sender.")]
MavlinkComponentOption = Annotated[
    int, typer.Option(help="MAVLink's component number of the sender.")
]
MavlinkMessagesOption = Annotated[
    str, typer.Option(help="MAVLink: both, obstacle_distance or distance_sensor.")
]
MavlinkUnknownOption = Annotated[
    str, typer.Option(help="What MAVLink says of an unknown frame: silence or message.")
]

StaleOption = Annotated[
    float,
    typer.Option(help="Seconds after which a frame is too old to be clear; in real time only."),
]
HeartbeatOption = Annotated[
    float,
    typer.Option(help="Seconds without a verdict after which unknown is sent; in real time only."),
]
WatchdogOption = Annotated[
    bool,
    typer.Option(
        "--watchdog",
        help="Start the runtime in a process of its own, again whenever it dies or hangs.",
    ),
]

LogOption = Annotated[
    Path | None, typer.Option(help="Add one JSON object a frame to this file, events beside it.")
]
LogValuesOption = Annotated[
    bool, typer.Option("--log-values", help="Log each patch's decision values too.")
]
LogMaxOption = Annotated[float, typer.Option(help="Megabytes after which a new log file begins.")]
LogKeepOption = Annotated[int, typer.Option(help="Older log files that are kept.")]
MetricsOption = Annotated[
    str | None,
    typer.Option(metavar="PORT", help="Serve Prometheus metrics on this port, or HOST:PORT."),
]
RecordOption = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Record the frames around detections, for tokt label."),
]
RecordMaxOption = Annotated[float, typer.Option(help="Megabytes that recordings may take.")]
RecordBeforeOption = Annotated[float, typer.Option(help="Seconds recorded before a detection.")]
RecordAfterOption = Annotated[float, typer.Option(help="Seconds recorded after a detection.")]
ShadowOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE|STORE",
        help="Another model that judges the same frames and is never sent; needs --shadow-log.",
    ),
]
ShadowLogOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="What the other model says; tokt shadow reads it."),
]

ExposureOption = Annotated[
    float | None, typer.Option(help="Live cameras: exposure time in microseconds.")
]
GainOption = Annotated[float | None, typer.Option(help="Live cameras: gain in dB.")]
PacketSizeOption = Annotated[
    int | None,
    typer.Option(help="Live cameras: bytes of a packet. Default: the largest that fits."),
]
BandwidthOption = Annotated[
    float | None, typer.Option(help="Live cameras: bytes per second, shared by all of them.")
]
CameraRateOption = Annotated[
    float | None, typer.Option(help="Live cameras: frames per second they are set to.")
]
TriggerOption = Annotated[
    str | None, typer.Option(help="Live cameras: what starts each exposure, such as Line1.")
]
PtpOption = Annotated[bool, typer.Option("--ptp", help="Live cameras: set their clocks by PTP.")]
WaitOption = Annotated[
    bool,
    typer.Option("--wait", help="Live cameras: wait for one that is not there at the start."),
]
JsonSummaryOption = Annotated[
    bool, typer.Option("--json", help="Print a summary as one JSON object at the end.")
]
