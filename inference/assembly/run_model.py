"""The model of a run: loaded, and exchanged for the next one of its store."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError, os_errors_as
from tokt.features.common.held_files import has_changed
from tokt.features.frames.view_mask import CameraMasks
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import RunConfig
from tokt.inference.monitoring.drift import DriftMonitor
from tokt.inference.policy.assembly import Assembly
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import Bundle, read_bundle
from tokt.models.sight import SightLimits

if TYPE_CHECKING:
    from tokt.inference.frame import Frame
    from tokt.inference.monitoring.reload import ModelReloader


class RunModel:
    """The model a run begins with."""

    def __init__(
        self, config: RunConfig, masks_of: Callable[[Bundle], CameraMasks], strict: bool
    ) -> None:
        self.bundle: Bundle | None = None  # it, once loaded
        self.fault = ""  # why it could not be loaded
        self.notes: list[str] = []  # why it is not the store's active one
        # Of the frames that the options call sharp: None without that option, empty without them.
        self.sight: tuple[SightLimits, ...] | None = None
        self.sight_fault = ""  # why it is empty
        self._wanted, self._pixel_format = config.model, config.source.pixel_format
        self._masks_of = masks_of  # what is no view in a run of a model
        self._strict = strict

    def _measure_sight(self, place: Path, bundle: Bundle) -> None:
        # Imported where it is asked for: a runtime without is started sooner.
        from tokt.features.frames.mission import open_mission
        from tokt.inference.sharp_frames import measure_sharp_frames

        masks, blind = self._masks_of(bundle), self._wanted.accept_blind
        try:
            if has_changed(place):
                raise ToktError(f"{place} has changed since the run began")
            with os_errors_as(f"cannot read {place}"):
                mission = open_mission(place)
                self.sight = measure_sharp_frames(
                    mission, masks, self._pixel_format, accept_blind=blind
                )
        except ToktError as error:
            # A run that is started again still has to warn: only clear needs these frames.
            if self._strict:
                raise
            self.sight, self.sight_fault = (), f"--sharp-frames: {error}"

    @property
    def loader(self) -> Callable[[], Bundle] | None:
        """What loads it; None where none was asked for."""
        return self.load if self._wanted.store or self._wanted.file else None

    def load(self) -> Bundle:
        """Read the model; ToktError where it cannot guard a vehicle."""
        try:
            if file := self._wanted.file:
                found = read_bundle(file)
                if found.deployment_fault:
                    fault = f"model {found.label} cannot guard a vehicle: {found.deployment_fault}"
                    raise ToktError(f"{file}: {fault}")
            else:
                assert self._wanted.store is not None
                from tokt.models.store.last_good import load_running
                from tokt.models.store.store import Store

                found, self.notes = load_running(Store(self._wanted.store))
            if self._wanted.sharp_frames is not None:
                self._measure_sight(self._wanted.sharp_frames, found)
            running = self.as_it_runs(found)
            self.check_sight(running)
        except ToktError as error:
            self.fault = str(error)
            raise
        self.bundle, self.fault = running, ""
        return self.bundle

    def check_sight(self, running: Bundle) -> None:
        """Raise ToktError if a model may call clear what shows nothing, unless that is accepted."""
        if self.sight is None:  # that of sharp frames was checked as it was measured
            running.check_sight(self._wanted.accept_blind)

    def as_it_runs(self, bundle: Bundle) -> Bundle:
        """Return a model with its boundary and its sight as the options want them."""
        if self.sight is not None:
            bundle = bundle.with_sight(self.sight)
        return bundle.with_fixed_boundary() if self._wanted.fixed_boundary else bundle

    @property
    def note(self) -> str:
        """What each verdict's health says of it: why it is not the active one, or not measured."""
        return _note_on(self.bundle, *self.notes, self.sight_fault)

    def words(self) -> list[str]:
        """Lines for people."""
        notes = filter(None, (*self.notes, self.sight_fault))
        lines = [f"WARNING: {note}" for note in notes]
        if self.bundle is None:
            return lines
        rule = self.bundle.operating_point.rule
        late = f"; {rule.latency_words()}" if rule.latency_frames else ""
        return [*lines, f"model {self.bundle.label}: status 1 with {rule.words()}{late}"]


def _note_on(bundle: Bundle | None, *notes: str) -> str:
    """Join notes; where no sight was measured, the start of the log says it for a replay, too."""
    unmeasured = bundle.blindness if bundle is not None and not bundle.sight else ""
    return "; ".join(filter(None, (*notes, unmeasured)))


class ModelExchange:
    """Exchange the model of a run for another one, between two frames."""

    def __init__(self, model: RunModel, assembly: Assembly, drift: DriftMonitor, threads: int):
        self._model, self._assembly, self._drift = model, assembly, drift
        self._threads = threads

    def put(self, bundle: Bundle, note: str) -> None:
        """Let a bundle judge from now on; `note` is what is not as it should be with it."""
        slot = self._assembly.texture
        assert slot is not None
        running = self._model.as_it_runs(bundle)
        detector = TextureDetector(running, self._threads, self._assembly.sight)
        slot.put(detector, _note_on(running, note, self._model.sight_fault))
        self._drift.set_model(bundle)

    def misfit(self, bundle: Bundle, frame: Frame | None = None) -> str:
        """Return why a bundle cannot judge in this run, or an empty string."""
        try:
            self._model.check_sight(self._model.as_it_runs(bundle))
        except ToktError as error:
            return str(error)
        return self._assembly.misfit(bundle, frame)


def open_model_watch(
    store: Path, model: RunModel, exchange: ModelExchange, opened: ExitStack
) -> ModelReloader:
    """Begin to look at a store for its next model."""
    from tokt.inference.monitoring.reload import ModelReloader
    from tokt.models.store.store import Store

    watch = ModelReloader(
        store=Store(store),
        running=model.bundle,
        misfit=exchange.misfit,
        put=exchange.put,
        clock=SYSTEM_CLOCK,
        is_active=not model.notes,
    )
    watch.start()
    opened.callback(watch.close)
    return watch
