"""The parts that verdicts depend on: source, policy with model and calibration, mask, object."""

from __future__ import annotations

import atexit
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError, UnavailableError
from tokt.features.common.terminal import say
from tokt.features.frames.mission import parse_frames
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Source
from tokt.inference.policy.assembly import Assembly, StereoSetup, assemble
from tokt.inference.policy.temporal_cues import Anchor
from tokt.inference.report import MODEL, Event
from tokt.inference.sources.files import MissionSource, open_source
from tokt.inference.sources.open import is_camera_source, open_camera_source
from tokt.inference.sources.stream import StreamSource, is_stream_source

from .parts import DETECTOR, SOURCE, Part, close_if_open
from .run_model import ModelExchange
from .run_state import RunState

if TYPE_CHECKING:
    from tokt.inference.runtime import Runtime
    from tokt.models.bundle.bundle import Bundle

_END_S = 1.0
"""Seconds from the end of all work until the system ends the process, if it does not by itself."""


def source_part(state: RunState) -> Part:
    """Return the source of the frames."""

    def join(source: Source) -> None:
        state.source = source
        state.opened.callback(close_if_open, source)

    return Part(
        option="source",
        value=state.config.source.source,
        open=partial(_open_source, state),
        join=join,
        kind=SOURCE,
        strict=True,
    )


def _open_source(state: RunState) -> Source:
    wanted = state.config.source
    if is_stream_source(wanted.source):
        return StreamSource(wanted.source, SYSTEM_CLOCK)
    if not is_camera_source(wanted.source):
        chosen = None if wanted.frames is None else parse_frames(wanted.frames)
        read_right = state.config.stereo.calibration is not None
        return open_source(
            wanted.source, SYSTEM_CLOCK, chosen, wanted.rate, read_right, wanted.pixel_format
        )
    if sys.platform != "win32":
        # As a program ends a vendor's library may wait for calls of its own, for ever.
        atexit.register(signal.setitimer, signal.ITIMER_REAL, _END_S)
    # A run that is started again had its cameras: one that is gone now is lost, and no mistake.
    wanted = replace(wanted, wait=wanted.wait or not state.strict)
    cameras = open_camera_source(wanted, SYSTEM_CLOCK, state.events.put)
    state.counting.cameras = cameras
    return cameras


def policy_part(state: RunState) -> Part:
    """Return the policy, which opens once one of its detectors can judge."""

    def join(assembly: Assembly) -> None:
        state.assembly = assembly
        if assembly.texture is not None:
            assembly.texture.note = state.model.note
        state.naming.cues = assembly.policy

    return Part(
        option="policy",
        value=state.config.policy.policy,
        open=partial(_assemble, state),
        join=join,
        kind=DETECTOR,
        strict=True,
    )


def _assemble(state: RunState) -> Assembly:
    """Assemble the policy; without its model or its calibration where the other one can judge."""
    config, pairs = state.config, None
    if config.stereo.calibration is not None:
        try:
            pairs, state.stereo_fault = _open_stereo(state), ""
        except ToktError as error:
            if state.strict:
                raise
            state.stereo_fault = str(error)
    size = config.policy.anchor
    return assemble(
        name=config.policy.policy,
        load_model=state.model.loader,
        stereo=pairs,
        threads=config.model.threads,
        anchor=None if size is None else Anchor(size),
        moving=config.policy.moving,
        stereo_fault=state.stereo_fault,
        alone=not state.strict,
    )


def _open_stereo(state: RunState) -> StereoSetup:
    from tokt.inference.stereo.calibration import read_calibration
    from tokt.inference.stereo.odometry import load_odometry

    stereo = state.config.stereo
    assert stereo.calibration is not None
    poses = None if stereo.odometry is None else load_odometry(stereo.odometry)
    calibration = read_calibration(stereo.calibration).usable(say)
    return StereoSetup(calibration, stereo.stereo, stereo.stereo_scale, poses)


def late_parts(state: RunState, runtime: Runtime, exchange: ModelExchange) -> Iterator[Part]:
    """Yield what a run can judge without: mask, object to hold, the other one of two detectors."""
    config, assembly = state.config, state.assembly
    assert assembly is not None
    if config.source.mask is not None:
        yield Part(
            option="mask",
            value=" ".join(config.source.mask),
            open=lambda: state.masks_of(state.model.bundle),
            join=partial(setattr, runtime, "masks"),
            strict=True,
        )
    named = config.policy.anchor_from
    if named is not None:
        mission = state.source.mission if isinstance(state.source, MissionSource) else None
        name = partial(state.naming.name_before, named, mission, config.source.pixel_format)
        yield Part("anchor_from", named, open=name, join=lambda _: None, strict=True)
    if assembly.late_stereo is not None:
        threads = config.model.threads
        yield Part(
            option="calibration",
            value=config.stereo.calibration,
            open=partial(_open_stereo, state),
            join=lambda pairs: assembly.put_stereo(pairs, threads),
        )
    if state.model.fault and config.model.file is not None:
        yield Part(
            option="bundle",
            value=config.model.file,
            open=partial(_load_late_model, state),
            join=partial(_put_late_model, state, exchange),
        )


def _load_late_model(state: RunState) -> Bundle:
    try:
        return state.model.load()
    except ToktError as error:  # disparity judges meanwhile, and no start ends for it
        raise UnavailableError(str(error)) from None


def _put_late_model(state: RunState, exchange: ModelExchange, bundle: Bundle) -> None:
    if misfit := exchange.misfit(bundle):
        raise ToktError(f"model {bundle.label} cannot judge in this run: {misfit}")
    exchange.put(bundle, "")
    words = f"model {bundle.label} runs from the next frame on"
    fields = {"label": bundle.label, "sha256": bundle.sha256}
    state.events.put(Event(SYSTEM_CLOCK.time(), MODEL, words, fields))
