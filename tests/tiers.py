"""The tiers of the tests: the folder of a test decides its tier, and how many examples it tries.

``make test`` runs what a change needs, ``make test-all`` everything; the Makefile says which tiers
these are. A test that belongs to another tier than its folder is marked with that tier's name.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath

from hypothesis import settings

HERE = Path(__file__).parent
STUDIES = HERE.parent / "studies" / "tests"
SHARES = {"quick": 0.25, "full": 1.0}
"""Hypothesis profiles of the command line, and the share of each test's examples that they try."""


@dataclass(frozen=True)
class Tier:
    """Tests that cost alike.

    Parameters
    ----------
    name : str
        The marker.
    folders : tuple of str
        Within `tests`; one name alone is any folder of that name. None for what is in no other.
        All tests of `studies/tests` are of the tier `study`.
    examples : int
        That Hypothesis tries where a test does not say how many.
    """

    name: str
    folders: tuple[str, ...]
    examples: int


_SLOW_ROOMS = ("compare", "fitting", "rig", "search")
CORE = Tier("core", (), 100)
STUDY = Tier("study", ("library", *(f"training/{room}" for room in _SLOW_ROOMS)), 50)
TIERS = (
    Tier("browser", ("labels/page/browser",), 20),
    Tier(
        "process",
        ("process", "docs/site", "labels/page/api", "models/registry", "inference/sources/video"),
        20,
    ),
    STUDY,
    Tier("load", ("load",), 20),
    Tier("fuzz", ("fuzz",), 100),
    CORE,
)
PROOF = (
    "inference/test_faults.py",
    "inference/sources/video/test_rtp.py",
    "features/kernels",
    "models/bundle",
    "models/store",
    "process/test_kill.py",
    "labels/page/browser/frame_view/test_browser_frame.py",
)
"""What every run holds, whatever its tier (marker ``proof``): no wrong clear, no picture that was
not sent, exact kernels, no bundle, store or command that is left half done, and a page on which
frames can be labelled.
"""
_share = SHARES["full"]


def _within(path: PurePosixPath, folder: str) -> bool:
    return path.is_relative_to(folder) or folder in path.parts[:-1]


@cache
def tier_of(path: Path) -> Tier:
    """The tier of a test file's folder."""
    if path.is_relative_to(STUDIES):
        return STUDY
    if not path.is_relative_to(HERE):  # the conftest.py of both
        return CORE
    within = PurePosixPath(path.relative_to(HERE).as_posix())
    return next(
        (tier for tier in TIERS if any(_within(within, folder) for folder in tier.folders)), CORE
    )


@cache
def is_proof(path: Path) -> bool:
    """Whether a test file is run each time."""
    return any(path.is_relative_to(HERE / proof) for proof in PROOF)


def scaled(examples: int) -> int:
    """So many examples in a full run, a share of them in a quick one; for Hypothesis's settings."""
    return max(5, round(examples * _share))


def register_profiles(name: str) -> None:
    """One profile a tier, as the command line's ``--hypothesis-profile`` wants it.

    A quick run tries the same few examples each time: what fails after a change fails by it.
    The others draw new ones, as each may find what none before did, and print how to repeat it.
    No example has a deadline: a busy machine is no fault.
    """
    global _share
    _share = SHARES[name]
    for tier in TIERS:
        settings.register_profile(
            tier.name,
            deadline=None,
            derandomize=name == "quick",
            print_blob=True,
            max_examples=scaled(tier.examples),
        )


# Known before the command line is read; each tier's own take their place (tests/fixtures.py).
for _name in SHARES:
    settings.register_profile(_name, deadline=None)
