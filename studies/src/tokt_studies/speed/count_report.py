"""The count of a run's instructions as a table."""

import sys

from .instruction_count import InstructionCount, StageCost

_PLAIN_WIDTH = 100
_WHAT = (
    "A stage is what it does itself, without the stages that it calls; counting adds some 10,000 "
    "instructions to each call. Moved is what the last cache had to fetch from memory or make room "
    "for, 64 bytes a line. On x86 it is AVX2 code, also where the processor has more."
)


def print_counts(count: InstructionCount) -> None:
    """Print the stages in the order of a frame, with sums up to its datagram, and after it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("stage", no_wrap=True)
    for heading in ("million instructions", "share", "kB moved"):
        table.add_column(heading, justify="right", no_wrap=True)
    whole = count.total().instructions

    def add(name: str, cost: StageCost, last: bool = False) -> None:
        share = f"{cost.instructions / whole:.1%}"
        moved = f"{cost.bytes_moved / 1e3:,.0f}"
        table.add_row(name, f"{cost.instructions / 1e6:.2f}", share, moved, end_section=last)

    for when in ("before", "after"):
        for cost in count.costs:
            if cost.when == when:
                add(cost.stage, cost)
        add(f"{when} the datagram", count.total(when), last=True)
    add("a frame", count.total())
    console.print(table)
    for line in _about_lines(count):
        console.print(line, markup=False)


def _about_lines(count: InstructionCount) -> list[str]:
    about = count.about
    said = ", ".join(
        f"{number} {word}" for key in ("said", "object") for word, number in about[key].items()
    )
    caches = ", ".join(f"{name} {size}" for name, size in about["caches"].items())
    pictures = f"{about['frame_size']} of a rendered dive, a mean of {about['frames']} frames"
    return [
        _WHAT,
        f"run: preset {about['preset']} on {pictures} ({said}), with moving things looked for, a "
        "named object held, the view drawn",
        f"caches (bytes, ways, bytes of a line): {caches}",
        "code: " + "; ".join(f"{name} {version}" for name, version in about["code"].items()),
    ]
