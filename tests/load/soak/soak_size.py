"""Sizes of a soak: the full one and a quick one."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class SoakSize:
    """Numbers of frames, kills and pauses of a soak.

    Parameters
    ----------
    frames : int
    bare_frames : int
        Of the same loop with nothing around it, to compare with.
    kills : int
        How often the real command is killed.
    rest_s : float
        Seconds between a frame's end and the next one.
    pause_every_s, pause_s : float
        How often no frame comes, and for how long.
    exchange_every_s : float
        How often another model becomes active.
    look_every_s : float
        How often its metrics are asked for, and its memory is looked at.
    log_mb : float
        Of a log file, after which the next one begins.
    log_keep : int
        Older log files.
    record_mb : float
        Of the disk, for recordings.
    """

    frames: int = 1_000_000
    bare_frames: int = 50_000
    kills: int = 20
    rest_s: float = 0.0
    pause_every_s: float = 30.0
    pause_s: float = 1.3
    exchange_every_s: float = 60.0
    look_every_s: float = 1.0
    log_mb: float = 5.0
    log_keep: int = 3
    record_mb: float = 20.0

    def of(self, frames: int) -> SoakSize:
        """The same of so many frames."""
        return replace(self, frames=frames, bare_frames=min(self.bare_frames, frames))


FULL = SoakSize()
QUICK = SoakSize(
    frames=3000,
    bare_frames=1000,
    kills=2,
    rest_s=2e-3,
    pause_every_s=4.0,
    exchange_every_s=3.0,
    log_mb=0.2,
    record_mb=1.0,
)
