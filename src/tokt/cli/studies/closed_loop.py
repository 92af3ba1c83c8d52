"""`tokt simulate --closed-loop`: fly the scenes, then say what came of it."""

from __future__ import annotations

from pathlib import Path

from tokt.cli import output
from tokt.features.common.errors import ToktError


def fly_and_report(
    folder: Path,
    scenes: str | None,
    methods: str | None,
    seed: int,
    runs: int,
    width: int | None,
    model: Path | None,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Carry out the command; the parameters are its options.

    Raises
    ------
    ToktError
        If one is out of its range, or a run cannot be flown.
    """
    from tokt.studies.simulation.loop.flight import METHODS, WIDTH
    from tokt.studies.simulation.loop.scenes import KINDS
    from tokt.studies.simulation.study import Study, fly_study

    if runs < 1:
        raise ToktError(f"at least one run is needed, not {runs}")
    if seed < 0:
        raise ToktError(f"a seed is 0 or more, not {seed}")
    study = Study(
        out=folder,
        scenes=_named(scenes, tuple(KINDS)),
        methods=_named(methods, METHODS),
        seeds=range(seed, seed + runs),
        width=WIDTH if width is None else width,
        model=model,
        jobs=-1 if jobs is None else jobs,
    )
    came = fly_study(study, output.progress, output.say)
    if as_json:
        output.print_json(came.to_json())
        return
    for line in came.words():
        print(line)


def _named(text: str | None, default: tuple[str, ...]) -> tuple[str, ...]:
    if text is None:
        return default
    return tuple(name.strip() for name in text.split(",") if name.strip())
