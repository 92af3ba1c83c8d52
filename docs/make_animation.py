"""Make pictures/tour.webp from a finished demo: ``python docs/make_animation.py demo-out``.

It labels a frame on the real page in headless Chromium, then builds, trains, deploys and runs: all
commands are run as they are shown, in a folder where the demo's mission is `synthetic`, and all
lines are those that they printed. Takes two minutes.
"""

import os
import socket
import subprocess
import sys
import tempfile
import textwrap
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib
import pandas as pd
from make_page_pictures import SETTLED_MS, TOKT, served, sign_in, tab, tokt
from PIL import Image, ImageDraw, ImageFont
from playwright.sync_api import Page

OUT = Path(__file__).parent / "pictures" / "tour.webp"
WIDTH, HEIGHT, CAPTION = 960, 540, 44
SIZE = (720, 438)  # of the pictures that are written, whose file is below half a megabyte
PAGE_SIZE = (1088, 612)  # of the labelling page, whose bar takes one line then
STEPS = ("Label", "Train", "Deploy", "Verdict")
FRAME = 86  # that is labelled; the store has labels of all others
FRAME_SIZE, PATCH, GRID = (360, 271), (36, 27), 10
HEADS, MARGINS = (26, 20), (32, 26)  # CSS pixels around the frame on the labelling page
OBSTACLE_KEY = "5"
COLUMNS, LINES, LINE_HEIGHT = 90, 23, 22
MAX_SHOWN = 3  # lines on the screen that one printed line may take; a longer one is passed over
RATE = 5
HEARD, MOMENT_MS, LAST_MS = range(49, 92, 4), 330, 1500  # datagrams when a picture is taken
SHOWN_MS = 90  # from a datagram to the picture in the page
VIEW_SIZE = (720, 664)  # of the live view's picture
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
MONO = ImageFont.truetype(str(FONTS / "DejaVuSansMono.ttf"), 17)
SANS = ImageFont.truetype(str(FONTS / "DejaVuSans.ttf"), 18)
BOLD = ImageFont.truetype(str(FONTS / "DejaVuSans-Bold.ttf"), 18)
DARK, LIGHT, FAINT, BLUE, GREEN = "#0d1117", "#e6edf3", "#8b949e", "#58a6ff", "#7ee787"

Scene = Iterator[tuple[Image.Image, int]]
"""Pictures, each with its milliseconds."""


def main(demo: Path) -> None:
    """Play the four scenes and write them."""
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        (home / "synthetic").symlink_to((demo / "synthetic").resolve())
        os.chdir(home)
        os.environ["LOGNAME"] = "anna"
        frames = [*label_scene(), *train_scene(), *deploy_scene(), *verdict_scene()]
    shown, times = zip(*frames, strict=True)
    pictures = [one.resize(SIZE, Image.Resampling.LANCZOS) for one in shown]
    pictures[0].save(
        OUT,
        save_all=True,
        append_images=pictures[1:],
        duration=list(times),
        loop=0,
        quality=45,
        method=6,
        kmin=1,  # whole pictures often: else a shadow of the scene before stays
        kmax=3,
    )
    print(f"{OUT}: {sum(times) / 1000:.1f} s, {OUT.stat().st_size / 1e6:.2f} MB")


def captioned(picture: Image.Image, step: int, words: str) -> Image.Image:
    """The picture of a scene over a line that says which step it is and what is done."""
    whole = Image.new("RGB", (WIDTH, HEIGHT + CAPTION), DARK)
    whole.paste(picture)
    draw = ImageDraw.Draw(whole)
    draw.line((0, HEIGHT, WIDTH, HEIGHT), BLUE, 2)
    x, y = 14, HEIGHT + CAPTION // 2 + 1
    for number, name in enumerate(STEPS):
        now = number == step
        draw.text((x, y), name, BLUE if now else FAINT, BOLD if now else SANS, "lm")
        x += int(draw.textlength(name, BOLD)) + 18
    draw.text((WIDTH - 14, y), words, LIGHT, SANS, "rm")
    return whole


def label_scene() -> Scene:
    """A person paints the tower's patches of one frame."""
    labels = pd.read_csv("synthetic/labels.csv")
    labels[labels.frame != FRAME].to_csv("others.csv", index=False)
    tokt("labels", "import", "others.csv", "--annotator", "anna")
    tower = labels[(labels.frame == FRAME) & (labels.label == "subsea_installation")]
    options = ("--no-browser", "--port", "0", "--annotator", "anna")
    with served("label", "synthetic", *options) as url, tab(*PAGE_SIZE) as page:
        sign_in(page, url)
        page.goto(f"{url.partition('?')[0]}#/label/left/{FRAME}")
        page.wait_for_timeout(SETTLED_MS)
        yield seen(page, None, "tokt label: what is open water, what is not?"), 1500
        page.keyboard.press(OBSTACLE_KEY)
        words = "Paint the patches of the tower"
        for row, patches in tower.groupby("row"):
            places = [middle(page, row, col) for col in patches.col]
            page.mouse.move(*places[0])
            page.mouse.down()
            for place in places:
                page.mouse.move(*place)
            page.mouse.up()
            yield seen(page, places[-1], words), 130
        button = page.get_by_text("Rest is ocean")
        box = button.bounding_box() or {}
        button.click()
        at = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.wait_for_selector('#save-state[data-state="saved"]')
        page.wait_for_timeout(SETTLED_MS)  # till what it says of the click is gone
        yield seen(page, at, "The rest is open water. Every click is saved"), 1600


def middle(page: Page, row: int, col: int) -> tuple[float, float]:
    """Where a patch is on the labelling page."""
    box = page.locator(".frame-canvas").bounding_box() or {}
    room = box["width"] - MARGINS[0], box["height"] - MARGINS[1]
    scale = min(room[0] / FRAME_SIZE[0], room[1] / FRAME_SIZE[1])
    x = (room[0] - FRAME_SIZE[0] * scale) / 2 + (col + 0.5) * PATCH[0] * scale
    y = (room[1] - FRAME_SIZE[1] * scale) / 2 + (row + 0.5) * PATCH[1] * scale
    return box["x"] + HEADS[0] + x, box["y"] + HEADS[1] + y


def seen(page: Page, pointer: tuple[float, float] | None, words: str) -> Image.Image:
    """The labelling page now, with the pointer, which Chromium does not draw."""
    page.wait_for_timeout(60)
    picture = shot(page).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)
    if pointer:
        x, y = (at * WIDTH / PAGE_SIZE[0] for at in pointer)
        arrow = [(0, 0), (0, 19), (5, 15), (9, 22), (12, 21), (8, 13), (14, 13)]
        shape = [(x + right, y + down) for right, down in arrow]
        ImageDraw.Draw(picture).polygon(shape, "white", "black")
    return captioned(picture, 0, words)


def shot(page: Page) -> Image.Image:
    """The page as a picture."""
    path = Path("shot.png")
    page.screenshot(path=path)
    return Image.open(path).convert("RGB")


def train_scene() -> Scene:
    """The dataset of all labels, and a model of it."""
    build = "dataset build tower --mission synthetic --block 5"
    train = "train tower --extractor lbp --name tower --embargo 1"
    screen: list[str] = []
    for command, words, hold in (
        (build, "All labels become one dataset version", 1100),
        (train, "One command cross-validates, trains and registers", 4000),
    ):
        screen.append(f"$ tokt {command}")
        yield terminal(screen, 1, words), 400
        lines = shown(tokt(*command.split()))
        *passing, last = [line for line in lines if is_progress(line)]
        for line in passing[:: max(1, len(passing) // 6)]:
            yield terminal([*screen, line], 1, words), 120
        screen += [last, *(line for line in lines if not is_progress(line))]
        yield terminal(screen, 1, words), hold


def is_progress(line: str) -> bool:
    """Whether a line only says how far something is."""
    return line.rpartition(": ")[2].replace("/", "").isdigit()


def deploy_scene() -> Scene:
    """The model on the ship's PC."""
    command = "deploy tower ship"
    words = "One file, checked before it is used"
    yield terminal([f"$ tokt {command}"], 2, words), 400
    screen = [f"$ tokt {command}", *shown(tokt(*command.split()))[:1]]
    yield terminal(screen, 2, words), 900
    command = "store ship"
    screen += [f"$ tokt {command}", *shown(tokt(*command.split()))]
    yield terminal(screen, 2, words), 1800


def shown(lines: Sequence[str]) -> list[str]:
    """What fits the screen: the lines that are no whole paragraphs."""
    return [line for line in lines if len(wrapped(line)) <= MAX_SHOWN]


def wrapped(line: str, columns: int = COLUMNS) -> list[str]:
    """A printed line as lines of the screen."""
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return textwrap.wrap(line, columns, subsequent_indent=indent) or [""]


def terminal(printed: Sequence[str], step: int, words: str) -> Image.Image:
    """The last lines of a terminal."""
    picture = Image.new("RGB", (WIDTH, HEIGHT), DARK)
    write(ImageDraw.Draw(picture), printed, 18, COLUMNS)
    return captioned(picture, step, words)


def write(draw: ImageDraw.ImageDraw, printed: Sequence[str], x: int, columns: int) -> None:
    """Write what was printed, from `x` on; commands are green."""
    lines = [
        (line, GREEN if whole.startswith("$") else LIGHT)
        for whole in printed
        for line in wrapped(whole, columns)
    ]
    for number, (line, colour) in enumerate(lines[-LINES:]):
        draw.text((x, 18 + number * LINE_HEIGHT), line, colour, MONO)


def verdict_scene() -> Scene:
    """The live view of a run, and the datagrams that it sends."""
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    heard: list[str] = []
    to_read = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    listen = subprocess.Popen([TOKT, "listen", "--port", port], **to_read)
    reader = threading.Thread(target=lambda: heard.extend(listen.stdout or ()), daemon=True)
    reader.start()
    run = f"--store ship --source synthetic --rate {RATE} --view 0"
    run += f" --format v1 --udp 127.0.0.1:{port}"
    commands = [f"$ tokt run {run}", "", f"$ tokt listen --port {port}"]
    try:
        with served("run", *run.split()) as url, tab(*VIEW_SIZE) as page:
            page.goto(url)
            for count in HEARD:
                while len(heard) < count:
                    page.wait_for_timeout(20)
                page.wait_for_timeout(SHOWN_MS)
                moment = verdict(shot(page), [*commands, *heard[count - 4 : count]])
                yield moment, LAST_MS if count == HEARD[-1] else MOMENT_MS
    finally:
        listen.terminate()
        listen.wait()


def verdict(view: Image.Image, printed: Sequence[str]) -> Image.Image:
    """The live view beside a terminal."""
    picture = Image.new("RGB", (WIDTH, HEIGHT), DARK)
    wide = VIEW_SIZE[0] * HEIGHT // VIEW_SIZE[1]
    picture.paste(view.resize((wide, HEIGHT), Image.Resampling.LANCZOS))
    write(ImageDraw.Draw(picture), printed, wide + 14, 34)
    return captioned(picture, 3, "tokt run: a verdict, the way to steer, a datagram a frame")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
