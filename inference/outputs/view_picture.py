"""The picture of the live view: frame, grid, mask, box, arrow, verdict, and a strip of a minute.

Every state has a word and a shape of its own, so that none is told by its colour alone. What is
unknown, old or over is said over the picture's whole width.
"""

from dataclasses import dataclass, field
from textwrap import wrap

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.frames.grid import Grid
from tokt.features.frames.view_mask import ViewMask
from tokt.inference.policy.object_model import Box
from tokt.inference.report import Report
from tokt.inference.verdict import CLEAR, OBSTACLE, STATUS_WORDS, UNKNOWN, Verdict
from tokt.models.sight import MAX_TOGETHER

WIDTH, BANNER, PANEL, STRIP = 720, 50, 120, 18
"""In pixels: of the picture, and the heights of what stands above and below the frame."""
STRIP_S = 60.0
"""Seconds that the strip shows."""
WAITING, OLD, ENDED = "WAITING", "OLD", "ENDED"

Colour = tuple[int, int, int]
_WHITE, _BLACK, _YELLOW, _GREY = (255, 255, 255), (0, 0, 0), (0, 200, 255), (70, 70, 70)
_GREEN, _LIGHT_GREY = (120, 255, 120), (170, 170, 170)
_COLOURS: dict[str, Colour] = {"OBSTACLE": (30, 30, 200), "CLEAR": (60, 110, 20)}
_RANKS = {CLEAR: 1, UNKNOWN: 2, OBSTACLE: 3}
"""A column of the strip shows the worst status of its time, 0 where nothing was said."""
_BARS = ((2, 3, _COLOURS["CLEAR"]), (1, 2, _YELLOW), (0, 3, _COLOURS["OBSTACLE"]))
_LINE_CHARACTERS, _MOST_LINES = 78, 4
"""Of a text as long as health may be, 250 bytes, at the size in which it is written."""
_STRIPED = np.arange(WIDTH) % 28 < 14


@dataclass(frozen=True)
class ViewMoment:
    """What was said, and the picture that it was said of.

    Times are of the clock that all processes share (`tokt.inference.clock.SystemClock.monotonic`).
    """

    report: Report
    said_s: float
    arrived_s: float  # its frame
    statuses: tuple[tuple[float, int], ...]  # said since the moment before, and when; with this one
    # `fitted` to be drawn; without one the one before stays, darkened.
    picture: U8 | None = None
    mask: U8 | None = None  # as of `tokt.inference.policy.policy.Judgement`
    grid: Grid | None = None
    held: Box | None = None
    refused: str = ""  # why what was drawn last cannot be held
    model: str = ""  # the one that runs; empty where there is none
    no_view: ViewMask | None = None


@dataclass(frozen=True)
class Shown:
    """What a picture says, in words: for the page, and drawn into it."""

    word: str
    why: str
    age_s: float
    facts: dict[str, str] = field(default_factory=dict)
    frame: int | None = None  # whose picture it is
    rows: tuple[int, int] = (0, 0)  # those of the picture that are the frame


@dataclass(eq=False)
class ViewState:
    """The newest moment, the last picture there was, and the last minute.

    Frames are old from `stale_s` on; `ended` says how the run ended, and is empty before.
    """

    stale_s: float
    ended: str = ""
    moment: ViewMoment | None = None
    picture: U8 | None = None
    frame: int | None = None  # whose picture that is
    statuses: list[tuple[float, int]] = field(default_factory=list)

    def take(self, moment: ViewMoment) -> None:
        """Show this from now on."""
        self.moment = moment
        if moment.picture is not None:
            self.picture, self.frame = moment.picture, moment.report.frame
        oldest = moment.said_s - STRIP_S - self.stale_s
        said = [*self.statuses, *moment.statuses]
        self.statuses = [each for each in said if each[0] >= oldest]

    def shown(self, now: float) -> Shown:
        """What is to be said at that time."""
        if self.moment is None:
            return Shown(ENDED if self.ended else WAITING, self.ended or "no frame yet", 0.0)
        verdict, age_s = self.moment.report.verdict, now - self.moment.arrived_s
        word, why = STATUS_WORDS[verdict.status].upper(), ""
        if self.ended:
            word, why = ENDED, self.ended
        elif verdict.status == UNKNOWN:
            # Its reason says more than that it is old, and the age counts up beside it.
            reason = f"{verdict.reason.value}: "
            why = reason + verdict.health.removeprefix(reason)
        elif age_s > self.stale_s:
            seen = "an obstacle was seen; " if verdict.status == OBSTACLE else ""
            word, why = OLD, f"{seen}nothing newer for {age_s:.1f} s"
        of_now = not self.ended and age_s <= self.stale_s
        named = filter(None, (verdict.anchor if of_now else None, self.moment.refused))
        facts = _facts(verdict, word in _COLOURS, ": ".join(named), self.moment.model)
        high = 0 if self.picture is None else len(self.picture)
        return Shown(word, why, age_s, facts, self.frame, (BANNER, BANNER + high))

    def draw(self, shown: Shown, now: float) -> U8:
        """The picture of a moment: BGR, of one size as long as the frames are, both sides even."""
        frame = np.zeros((540, WIDTH, 3), np.uint8) if self.picture is None else self.picture.copy()
        if self.moment is not None and self.picture is not None:
            _draw_mask(frame, self.moment.no_view)
        if shown.word in _COLOURS and self.moment is not None and self.moment.picture is not None:
            _draw_verdict(frame, self.moment)
            _draw_blind(frame, self.moment.report.verdict)
        else:
            cv2.convertScaleAbs(frame, frame, 0.35)
            if self.moment is not None and not self.ended:
                _draw_blind(frame, self.moment.report.verdict)
            _draw_band(frame, shown)
        whole = np.vstack((_banner(shown), frame, _panel(shown), self._strip(now)))
        return np.asarray(whole[: len(whole) // 2 * 2])

    def _strip(self, now: float) -> U8:
        """The last minute: an obstacle is a high bar, unknown a middle one, clear a low one."""
        strip = np.full((STRIP, WIDTH, 3), 30, np.uint8)
        if not self.statuses:
            return strip
        times, ranks = np.array([(at, _RANKS[status]) for at, status in self.statuses]).T
        at = now - STRIP_S * (1 - (np.arange(WIDTH) + 0.5) / WIDTH)
        last = np.searchsorted(times, at) - 1
        held = (last >= 0) & (at - times[last] <= self.stale_s)
        columns = np.where(held, ranks[last], 0)
        # A status that was said between two columns counts as well.
        place = ((times - now + STRIP_S) / STRIP_S * WIDTH).astype(int).clip(max=WIDTH - 1)
        seen = times > now - STRIP_S
        np.maximum.at(columns, place[seen], ranks[seen])
        for rank, (top, bottom, colour) in enumerate(_BARS, 1):
            strip[top * STRIP // 3 : bottom * STRIP // 3, columns == rank] = colour
        return strip


def _facts(verdict: Verdict, of_now: bool, named: str, model: str) -> dict[str, str]:
    """The rest of a verdict, in words; where to only while it is of now."""
    told: dict[str, str] = {"model": model or verdict.model or verdict.method}
    if of_now and verdict.distance_m is not None:
        told["distance"] = f"{verdict.distance_m:.1f} m"
    ways = ((verdict.x, "left", "right"), (verdict.y, "up", "down"))
    steer = [f"{less if px < 0 else more} {abs(px)} px" for px, less, more in ways if px]
    if of_now and steer:
        told["steer"] = ", ".join(steer)
    if named:
        told["object"] = named
    if (seen := (verdict.sight or {}).get("visibility")) is not None:
        told["visibility"] = f"{100 * seen[0]:.0f} %"
    return {**told, "health": verdict.health}


def fitted(picture: U8) -> U8:
    """A frame in colour, `WIDTH` wide: 1 ms; a mean of what each pixel covers would take ten."""
    # A strip of a picture would become as high as the memory is.
    high = min(max(round(picture.shape[0] * WIDTH / picture.shape[1]), 2), 2 * WIDTH)
    picture = np.asarray(cv2.resize(picture, (WIDTH, high)), np.uint8)
    return picture if picture.ndim == 3 else np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))


def _draw_verdict(frame: U8, moment: ViewMoment) -> None:
    """The grid, the cells judged obstacle, the box around them and the way to steer."""
    height, verdict = frame.shape[0], moment.report.verdict
    high, wide = verdict.mask_size or (height, WIDTH)
    if moment.grid is not None:
        patch_high, patch_wide = moment.grid.patch_size(high, wide)
        lines = [frame[row * patch_high * height // high] for row in range(1, moment.grid.rows)]
        across = [col * patch_wide * WIDTH // wide for col in range(1, moment.grid.cols)]
        for line in [*lines, *(frame[:, x] for x in across)]:
            line[:] = line // 2 + 70
    if moment.mask is not None and moment.mask.any():
        mask = cv2.resize(moment.mask, (WIDTH, height), interpolation=cv2.INTER_NEAREST)
        # Hatched: what is beneath stays to be seen, and nothing in the sea looks like it.
        rows, columns = np.ogrid[:height, :WIDTH]
        frame[(mask > 0) & ((rows + columns) % 13 < 2)] = _YELLOW
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(frame, outlines, -1, _YELLOW, 2)
    if moment.held is not None:
        x, y, wide, high = (round(float(px)) for px in moment.held * np.tile((WIDTH, height), 2))
        cv2.rectangle(frame, (x, y, wide, high), _BLACK, 5)
        cv2.rectangle(frame, (x, y, wide, high), _GREEN, 2)
        _write(frame, "HELD", (max(x, 0), max(y - 6, 18)), 0.7, _GREEN)
    if verdict.box is None:
        return
    x, y, box_wide, box_high = verdict.box
    corners = ((x, y), (x + box_wide - 1, y + box_high - 1))
    one, other = [(x * WIDTH // wide, y * height // high) for x, y in corners]
    cv2.rectangle(frame, one, other, _WHITE, 2)
    way, middle = np.array([verdict.x or 0, verdict.y or 0], float), np.array([WIDTH, height]) / 2
    if way.any():
        tip = middle + way / np.hypot(*way) * min(WIDTH, height) / 4
        start, end = middle.astype(int).tolist(), tip.astype(int).tolist()
        for colour, thick in ((_BLACK, 9), (_WHITE, 4)):
            cv2.arrowedLine(frame, start, end, colour, thick, cv2.LINE_AA, tipLength=0.35)


def _draw_mask(frame: U8, mask: ViewMask | None) -> None:
    """Hatch and darken what is no view."""
    if mask is None:
        return
    height, width = frame.shape[:2]
    masked = mask.pixels(height, width)
    frame[masked] //= 2
    rows, columns = np.ogrid[:height, :width]
    # The other way than an obstacle's.
    frame[masked & ((rows - columns) % 16 < 2)] = _LIGHT_GREY


def _draw_blind(frame: U8, verdict: Verdict) -> None:
    """Draw a box around the largest part in which nothing would be seen, unless it is small."""
    x, y, wide, high = (verdict.sight or {}).get("blind", (0.0,) * 4)
    if wide * high <= MAX_TOGETHER:
        return
    parts, sides = (x, y, wide, high), (WIDTH, frame.shape[0]) * 2
    box = [round(part * side) for part, side in zip(parts, sides, strict=True)]
    for colour, thick in ((_BLACK, 6), (_WHITE, 2)):
        cv2.rectangle(frame, box, colour, thick)
    _write(frame, "NOT SEEN", (box[0] + 8, box[1] + 24), 0.7, _WHITE)


def _draw_band(frame: U8, shown: Shown) -> None:
    """Words over the whole width, where a picture is none to go by."""
    middle = frame.shape[0] // 2
    band = frame[max(0, middle - 90) : middle + 90]
    band[:] = _BLACK
    band[:10, _STRIPED] = band[-10:, _STRIPED] = _YELLOW
    _write(band, shown.word, (None, 68), 2.1, _YELLOW)
    for line, text in enumerate(_lines(shown.why)):
        _write(band, text, (None, 94 + 20 * line), 0.62, _WHITE)


def _banner(shown: Shown) -> U8:
    """The verdict's word, a shape that no other has, and the age."""
    banner = np.full((BANNER, WIDTH, 3), _COLOURS.get(shown.word, _BLACK), np.uint8)
    if shown.word == "OBSTACLE":
        cv2.fillPoly(banner, [np.array([(25, 8), (7, 42), (43, 42)])], _WHITE, cv2.LINE_AA)
    elif shown.word == "CLEAR":
        cv2.circle(banner, (25, 25), 17, _WHITE, 3, cv2.LINE_AA)
    else:
        banner[:, _STRIPED] = _GREY
        cv2.drawMarker(banner, (25, 25), _YELLOW, cv2.MARKER_TILTED_CROSS, 34, 3)
    _write(banner, shown.word, (68, 37), 1.3, _WHITE)
    if shown.word not in (WAITING, ENDED):
        _write(banner, f"{shown.age_s:.1f} s", (590, 37), 1.1, _WHITE)
    return banner


def _panel(shown: Shown) -> U8:
    """The other facts, and health over as many lines as it takes."""
    panel = np.full((PANEL, WIDTH, 3), 20, np.uint8)
    facts = [f"{name} {text}" for name, text in shown.facts.items()]
    for line, text in enumerate(("   ".join(facts[:-1]), *_lines("".join(facts[-1:])))):
        _write(panel, text, (9, 21 + 22 * line), 0.62, _WHITE)
    return panel


def _lines(text: str) -> list[str]:
    """Break words into lines that fit the picture; health is cut where it is sent (`report`)."""
    return wrap(text, _LINE_CHARACTERS)[:_MOST_LINES]


def _write(on: U8, text: str, at: tuple[int | None, int], scale: float, colour: Colour) -> None:
    """Write a line, from `at` or in the middle, smaller where it is long; to be cut at the end."""
    text = text.encode("ascii", "replace").decode()
    wide = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0] or 1
    room = WIDTH - (at[0] or 0) - 12
    smaller = max(0.6, min(1.0, room / wide))
    left = max(6, int(WIDTH - wide * smaller) // 2) if at[0] is None else at[0]
    thick = max(1, round(2 * scale * smaller))
    font = (cv2.FONT_HERSHEY_SIMPLEX, scale * smaller, colour, thick, cv2.LINE_AA)
    cv2.putText(on, text, (left, at[1]), *font)
