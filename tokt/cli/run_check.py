"""Refuse what a user of `tokt run` cannot have meant, before anything is opened."""

from __future__ import annotations

from ..features.errors import ToktError
from ..inference.anchor import Anchor
from ..inference.cameras.open import is_camera_source
from ..inference.frame_stream import is_stream_source
from ..inference.run_log import events_path
from ..inference.udp import parse_receiver, version_of
from .run_asked import Asked

_LOGS = ("log", "shadow_log")
_NEEDS = {
    "log_values": ("log",),
    **dict.fromkeys(("log_max_mb", "log_keep"), _LOGS),
    **dict.fromkeys(("record_mb", "record_before", "record_after"), ("record",)),
    **dict.fromkeys(("camera_fov_deg", "mavlink_assumed_m"), ("mavlink",)),
    **dict.fromkeys(("mavlink_system", "mavlink_component"), ("mavlink",)),
    **dict.fromkeys(("mavlink_messages", "mavlink_unknown"), ("mavlink",)),
    "shadow": ("shadow_log",),
    "shadow_log": ("shadow",),
}
"""Options, and those of which they need one to do anything."""

_FOR_CAMERAS = (
    *("exposure_us", "gain_db", "packet_size", "bandwidth"),
    *("camera_rate", "trigger", "ptp", "wait"),
)
_FOR_FILES = ("frames", "rate")
_FOR_REAL_TIME = ("stale", "heartbeat")


def check(asked: Asked) -> None:
    """Refuse options that contradict each other, and those that would do nothing.

    Raises
    ------
    ToktError
    """
    if asked.store is not None and asked.bundle is not None:
        raise ToktError("give --store or --bundle, not both")
    for name, needs in _NEEDS.items():
        if name in asked.given and asked.given.isdisjoint(needs):
            words = " or ".join(map(_option, needs))
            raise ToktError(f"{_option(name)} is of no use without {words}")
    if asked.log is not None and asked.shadow_log is not None:
        taken = {path.absolute() for path in (asked.log, events_path(asked.log))}
        if asked.shadow_log.absolute() in taken:
            raise ToktError("--shadow-log names a file that --log writes: give it one of its own")
    _check_anchor(asked)
    if is_camera_source(asked.source):
        _refuse(asked, _FOR_FILES, "recorded frames, not for live cameras")
    else:
        _refuse(asked, _FOR_CAMERAS, "live cameras (--source pymba:ID or genicam:ID)")
        if is_stream_source(asked.source):
            _refuse(asked, (*_FOR_FILES, "pixel_format"), "recorded frames, not for a stream")
        if asked.rate is None:
            _refuse(asked, _FOR_REAL_TIME, "live cameras, or recorded frames with --rate")
    if asked.policy == "disparity":
        _refuse(asked, ("threads",), "the policies that use a model")


def _check_anchor(asked: Asked) -> None:
    """Refuse a share that cannot be held, and one of which nobody would hear."""
    if asked.anchor is None:
        return
    Anchor(asked.anchor)
    version = version_of(asked.format_)
    versions = {parse_receiver(text, version).version for text in asked.udp or []} or {version}
    if versions == {1} and asked.log is None and asked.record is None:
        raise ToktError(
            "--anchor is of no use without a receiver of v2 (--format v2 or --udp v2@HOST:PORT), "
            "--log or --record"
        )


def _refuse(asked: Asked, names: tuple[str, ...], what_for: str) -> None:
    for name in names:
        if name in asked.given:
            raise ToktError(f"{_option(name)} is for {what_for}")


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")
