"""What a user asked `tokt run` for."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path


@dataclass(frozen=True)
class Asked:
    """What a user asked for; the names are the command's options.

    `given` are the names of those that the user wrote.
    """

    given: frozenset[str]
    source: str
    store: Path | None
    bundle: Path | None
    frames: str | None
    calibration: Path | None
    stereo: str
    stereo_scale: float
    odometry: Path | None
    policy: str
    anchor: float | None
    udp: list[str] | None
    format_: str
    mavlink: list[str] | None
    camera_fov_deg: float | None
    mavlink_assumed_m: float
    mavlink_system: int
    mavlink_component: int
    mavlink_messages: str
    mavlink_unknown: str
    rate: float | None
    threads: int
    pixel_format: str | None
    exposure_us: float | None
    gain_db: float | None
    packet_size: int | None
    bandwidth: float | None
    camera_rate: float | None
    trigger: str | None
    ptp: bool
    wait: bool
    stale: float
    heartbeat: float
    log: Path | None
    log_values: bool
    log_max_mb: float
    log_keep: int
    metrics: str | None
    record: Path | None
    record_mb: float
    record_before: float
    record_after: float
    shadow: Path | None
    shadow_log: Path | None

    @classmethod
    def names(cls) -> set[str]:
        """Of all options, and `given`."""
        return {item.name for item in fields(cls)}
