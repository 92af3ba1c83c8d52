"""Checks of the options of a run against each other."""

from __future__ import annotations

from tokt.features.common.errors import ToktError
from tokt.inference.config import (
    CAMERAS,
    FILES,
    LIVE,
    MODELS,
    OPTIONS,
    PICTURES,
    REAL_TIME,
    VIDEO,
    RunConfig,
    StereoConfig,
)
from tokt.inference.outputs.udp import parse_receiver, version_of
from tokt.inference.policy.assembly import check_policy
from tokt.inference.policy.temporal_cues import Anchor
from tokt.inference.sources.open import is_camera_source
from tokt.inference.sources.stream import is_stream_source
from tokt.inference.sources.video.address import is_video_source


def check_options(config: RunConfig) -> None:
    """Refuse options that contradict each other, and those that would do nothing."""
    if config.monitoring.watchdog:
        raise ToktError("--watchdog is for the command tokt run: it starts processes")
    given = [each for each in OPTIONS.values() if each.name in config.given]
    for each in given:
        for other in config.given.intersection(each.not_with):
            raise ToktError(f"give --{each.key} or --{OPTIONS[other].key}, not both")
        if each.needs and config.given.isdisjoint(each.needs):
            words = " or ".join(f"--{OPTIONS[name].key}" for name in each.needs)
            raise ToktError(f"--{each.key} is of no use without {words}")
    log, shadow_log = config.recording.log, config.model.shadow_log
    if log is not None and shadow_log is not None:
        from tokt.inference.recording.run_log import events_path

        if shadow_log.absolute() in (log.absolute(), events_path(log).absolute()):
            raise ToktError("--shadow-log names a file that --log writes: give it one of its own")
    _check_told(config)
    useless = _useless(config)
    for each in given:
        if each.only in useless:
            raise ToktError(f"--{each.key} is for {useless[each.only]}")
    _check_judging(config)


def _useless(config: RunConfig) -> dict[str, str]:
    """The kinds of runs that this one is not; what options for them are for."""
    source = config.source.source
    useless: dict[str, str] = {}
    if is_video_source(source):
        useless |= {CAMERAS: CAMERAS, **dict.fromkeys((FILES, PICTURES), f"{FILES}, not for video")}
    elif is_camera_source(source):
        useless |= {VIDEO: VIDEO, FILES: f"{FILES}, not for live cameras"}
    else:
        useless |= {CAMERAS: CAMERAS, VIDEO: VIDEO, LIVE: LIVE}
        if is_stream_source(source):
            useless |= dict.fromkeys((FILES, PICTURES), f"{FILES}, not for a stream")
        if config.source.rate is None:
            useless[REAL_TIME] = REAL_TIME
    if config.policy.policy == "disparity":
        useless[MODELS] = MODELS
    return useless


def _check_judging(config: RunConfig) -> None:
    """Refuse a policy that lacks what it needs, and stereo options without a calibration."""
    if config.stereo.calibration is None and config.stereo != StereoConfig():
        raise ToktError("stereo needs a calibration (--calibration FILE.yml)")
    check_policy(
        name=config.policy.policy,
        has_model=bool(config.model.store or config.model.file),
        has_calibration=config.stereo.calibration is not None,
        threads=config.model.threads,
    )


def _check_told(config: RunConfig) -> None:
    """Refuse an anchor or a place of which nobody would hear, and a share that cannot be held."""
    policy = config.policy
    if policy.anchor is not None:
        Anchor(policy.anchor)
    asked = {"anchor": policy.anchor, "anchor-from": policy.anchor_from, "nmea": config.source.nmea}
    version = version_of(config.outputs.format)
    receivers = config.outputs.udp or []
    versions = {parse_receiver(text, version).version for text in receivers} or {version}
    if versions != {1} or config.recording.log is not None or config.recording.record is not None:
        return
    for name in (name for name, value in asked.items() if value is not None):
        raise ToktError(
            f"--{name} is of no use without a receiver of v2 (--format v2 or --udp v2@HOST:PORT), "
            "--log or --record"
        )
