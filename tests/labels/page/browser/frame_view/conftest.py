"""One frame's page in a real browser, and what the store holds of it."""

import pytest

from tokt.features.frames.grid import Grid
from tokt.labels.store.store import LabelStore

GRID = Grid(10, 10, 360)
HEADS = (26, 20)  # CSS pixels that row and column heads take
MARGINS = (32, 26)  # the heads and the opposite edges
PATCH = (36, 27)
FRAME = (360, 272)


class FramePage:
    """The page of one frame, and where its patches lie on the screen."""

    def __init__(self, page, server, frame):
        self.page, self.server = page, server
        self.wait(frame)

    def wait(self, frame):
        """Wait until the frame's picture and labels are there."""
        self.page.wait_for_function(
            "text => document.querySelector('#status')?.textContent.includes(text)"
            " && / of \\d+ labelled/.test(document.querySelector('#status').textContent)",
            arg=f"left frame {frame} ",
        )

    def open(self, frame):
        """Go to a frame as a link does."""
        self.page.goto(self.page.url.split("#")[0] + f"#/label/left/{frame}")
        self.wait(frame)

    def at(self, cell):
        """The middle of a patch on the screen."""
        box = self.page.locator(".frame-canvas").bounding_box()
        assert box is not None
        room = box["width"] - MARGINS[0], box["height"] - MARGINS[1]
        scale = min(room[0] / FRAME[0], room[1] / FRAME[1])
        row, col = divmod(cell, GRID.cols)
        x = (room[0] - FRAME[0] * scale) / 2 + (col + 0.5) * PATCH[0] * scale
        y = (room[1] - FRAME[1] * scale) / 2 + (row + 0.5) * PATCH[1] * scale
        return box["x"] + HEADS[0] + x, box["y"] + HEADS[1] + y

    def row_head(self, row):
        """The head of a row on the screen."""
        box = self.page.locator(".frame-canvas").bounding_box()
        assert box is not None
        return box["x"] + HEADS[0] / 3, self.at(row * GRID.cols)[1]

    def point(self, cell):
        """Put the pointer on a patch, coming from another one."""
        self.page.mouse.move(*self.at((cell + 37) % GRID.n_patches))
        self.page.mouse.move(*self.at(cell))

    def click(self, *cells, button="left"):
        for cell in cells:
            self.page.mouse.click(*self.at(cell), button=button)

    def label(self, key, *cells):
        """Choose a class or a tool by its key, and click patches."""
        self.press(key)
        self.click(*cells)

    def click_holding(self, key, cell):
        """Click a patch with a key held down."""
        self.page.keyboard.down(key)
        self.click(cell)
        self.page.keyboard.up(key)

    def drag(self, *cells):
        """Press on the first patch, jump to each other one in a single step, release."""
        self.page.mouse.move(*self.at(cells[0]))
        self.page.mouse.down()
        for cell in cells[1:]:
            self.page.mouse.move(*self.at(cell))
        self.page.mouse.up()

    def press(self, *keys):
        for key in keys:
            self.page.keyboard.press(key)

    def state(self, state):
        """Wait until the header shows a state."""
        self.page.wait_for_selector(f'#save-state[data-state="{state}"]')

    def saved(self):
        """Wait until the page says that all is saved."""
        self.state("saved")

    def shows(self, selector, text):
        """Wait until an element contains a text."""
        self.page.wait_for_function(
            "([where, what]) => document.querySelector(where)?.textContent.includes(what)",
            arg=[selector, text],
        )

    def text(self, selector):
        return self.page.locator(selector).text_content() or ""

    def stored(self, frame, who="anna"):
        """The labels of a frame by cell, read from the store's file when all is saved."""
        self.saved()
        return {one.row * GRID.cols + one.col: one.label for one in self.records(frame, who)}

    def records(self, frame, who="anna"):
        """The labels of a frame, as the store's file has them now."""
        with LabelStore(self.server.workspace / "labels.db") as store:
            return store.current("tiny", who, GRID, frame=frame)


@pytest.fixture
def open_frame(browse, server):
    """Open a frame in a tab of its own; of another server than the module's if one is given."""

    def start(frame, server=server, **options):
        page = browse(server, f"#/label/left/{frame}", **options)
        return FramePage(page, server, frame)

    return start


SETTINGS = {"filter": "all", "confidence": 0.5, "follow": 2, "selected": ""}


@pytest.fixture(scope="module")
def tab(profiles, annas, server):
    return FramePage(profiles.open(annas, server.url, "#/label/left/1"), server, 1)


@pytest.fixture
def view(tab, profiles):
    """A tab that a module's tests share; what they set is as at first again."""
    tab.page.evaluate(
        "values => { import('/static/core/mission.js').then(({ setSetting }) =>"
        " Object.entries(values).forEach(([name, value]) => setSetting(name, value))); }",
        SETTINGS,
    )
    yield tab
    profiles.check()


@pytest.fixture(scope="session")
def frame_page():
    return FramePage


@pytest.fixture(scope="session")
def obstacles_said():
    """Patches of a frame that a server's model calls an obstacle: ``obstacles_said(server, 8)``."""

    def found(server, frame):
        query = {"who": "nobody", "camera": "left", "frames": frame, "suggest": 1}
        [labels] = server.get("/api/labels", **query)["frames"]
        is_obstacle = server.get("/api/mission", who="nobody")["model"]["obstacle"]
        classes = labels["suggestions"]["classes"]
        return {cell for cell, which in enumerate(classes) if is_obstacle[which]}

    return found
