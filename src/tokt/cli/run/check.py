"""Refusal of what a user of `tokt run` cannot have meant, before anything is opened."""

from __future__ import annotations

from tokt.features.common.errors import ToktError
from tokt.inference.config import CAMERAS, FILES, MODELS, OPTIONS, PICTURES, REAL_TIME, RunConfig
from tokt.inference.outputs.udp import parse_receiver, version_of
from tokt.inference.policy.temporal_cues import Anchor
from tokt.inference.recording.run_log import events_path
from tokt.inference.sources.cameras.open import is_camera_source
from tokt.inference.sources.stream import is_stream_source


def check(config: RunConfig) -> None:
    """Refuse options that contradict each other, and those that would do nothing.

    Raises
    ------
    ToktError
    """
    given = [each for each in OPTIONS.values() if each.name in config.given]
    for each in given:
        if each.not_with in config.given:
            raise ToktError(f"give --{each.key} or --{OPTIONS[each.not_with].key}, not both")
        if each.needs and config.given.isdisjoint(each.needs):
            words = " or ".join(f"--{OPTIONS[name].key}" for name in each.needs)
            raise ToktError(f"--{each.key} is of no use without {words}")
    log, shadow_log = config.recording.log, config.model.shadow_log
    logs = () if log is None else (log, events_path(log))
    if shadow_log is not None and shadow_log.absolute() in [path.absolute() for path in logs]:
        raise ToktError("--shadow-log names a file that --log writes: give it one of its own")
    _check_anchor(config)
    useless = _useless(config)
    for each in given:
        if each.only in useless:
            raise ToktError(f"--{each.key} is for {useless[each.only]}")


def _useless(config: RunConfig) -> dict[str, str]:
    """The kinds of runs that this one is not; what options for them are for."""
    source, useless = config.source.source, {}
    if is_camera_source(source):
        useless[FILES] = f"{FILES}, not for live cameras"
    else:
        useless[CAMERAS] = CAMERAS
        if is_stream_source(source):
            useless |= dict.fromkeys((FILES, PICTURES), f"{FILES}, not for a stream")
        if config.source.rate is None:
            useless[REAL_TIME] = REAL_TIME
    if config.policy.policy == "disparity":
        useless[MODELS] = MODELS
    return useless


def _check_anchor(config: RunConfig) -> None:
    """Refuse a share that cannot be held, and one of which nobody would hear."""
    if config.policy.anchor is None:
        return
    Anchor(config.policy.anchor)
    version = version_of(config.outputs.format)
    receivers = config.outputs.udp or []
    versions = {parse_receiver(text, version).version for text in receivers} or {version}
    if versions == {1} and config.recording.log is None and config.recording.record is None:
        raise ToktError(
            "--anchor is of no use without a receiver of v2 (--format v2 or --udp v2@HOST:PORT), "
            "--log or --record"
        )
