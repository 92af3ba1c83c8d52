"""Real servers of the labelling page, in processes of their own, and a real browser."""

import http.client
import json
import re
import signal
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qs, urlencode, urlsplit

import pytest

from tests.forking import ForkedProcess, ForkHost
from tests.waiting import MAX_S

TIME = "2016-04-20T10:00:00Z"
IMPORTS = (
    "import tokt.cli.labels, tokt.labels.page.api.serve, tokt.labels.page.api.app, uvicorn.server"
)


@dataclass(frozen=True)
class Answer:
    """What the server answered."""

    status: int
    headers: http.client.HTTPMessage
    body: bytes

    @property
    def json(self):
        return json.loads(self.body)


@dataclass
class PageServer:
    """A `tokt label` process and how to reach it."""

    host: ForkHost
    mission: Path
    workspace: Path
    arguments: tuple[str, ...] = ()
    port: int = 0
    url: str = ""
    process: ForkedProcess = field(init=False, repr=False)

    def start(self):
        """Start the process, on the port it had before if it had one, and wait until it answers."""
        words = ["--port", self.port, "--workspace", self.workspace, *self.arguments]
        self.process = self.host.start("label", self.mission, "--no-browser", *words)
        line = self.process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, f"tokt label: {line}{self.process.stderr.read()}"
        self.url, self.port = found[0], urlsplit(found[0]).port
        return self

    @property
    def authority(self):
        """The header that shows the token of its address; none where that has none."""
        (token,) = parse_qs(urlsplit(self.url).query).get("token", [None])
        return {} if token is None else {"Authorization": f"Bearer {token}"}

    def kill(self):
        """End it at once, as a crash would."""
        self.process.kill()
        self._ended()

    def interrupt(self):
        """Ctrl-C; the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self._ended()

    def _ended(self):
        code = self.process.wait(MAX_S)
        self.process.stdout.close()
        self.process.stderr.close()
        return code

    def connect(self):
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=MAX_S)

    def request(self, method, target, body=None, headers=None):
        """One request, with the token unless an empty ``Authorization`` is given."""
        headers = {**self.authority, **(headers or {})}
        if not headers.get("Authorization"):
            headers.pop("Authorization", None)
        with closing(self.connect()) as connection:
            connection.request(method, target, body, headers)
            answer = connection.getresponse()
            return Answer(answer.status, answer.headers, answer.read())

    def get(self, path, **query):
        """JSON of a GET that must succeed."""
        answer = self.request("GET", f"{path}?{urlencode(query)}")
        assert answer.status == 200, answer.body
        return answer.json

    def send(self, path, body):
        """A POST of JSON."""
        headers = {"Content-Type": "application/json"}
        return self.request("POST", path, json.dumps(body).encode(), headers)

    def post(self, path, **body):
        """JSON of a POST that must succeed."""
        answer = self.send(path, body)
        assert answer.status == 200, answer.body
        return answer.json

    def events(self, **query):
        return EventStream(self, query)

    def paint(self, key, frame, cells, label, *, base=None, who="anna", camera="left", **more):
        """An action on one frame that must be accepted."""
        change = {"camera": camera, "frame": frame, "label": label, "cells": cells}
        change["base"] = [base] * len(cells)
        body = {"key": key, "who": who, "kind": "paint", "time": TIME, "changes": [change]}
        return self.post("/api/actions", **{**body, **more})


class EventStream:
    """An open stream of server-sent events."""

    def __init__(self, server, query):
        self._connection = server.connect()
        target = f"/api/events?{urlencode(query)}"
        self._connection.request("GET", target, headers=server.authority)
        self._answer = self._connection.getresponse()
        assert self._answer.status == 200

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self._connection.close()

    def next(self, wanted):
        """Data of the next event of that name; comments are the events of name ``""``."""
        for name, data in self._read():
            if name == wanted:
                return data
        raise EOFError("the stream ended")

    def rest(self):
        """All events up to the end of the stream, which the server has to end."""
        return [(name, data) for name, data in self._read() if name]

    def _read(self):
        name, data = "", None
        while line := self._answer.readline().decode():
            field_name, _, text = line.rstrip("\n").partition(": ")
            if field_name == "event":
                name = text
            elif field_name == "data":
                data = json.loads(text)
            elif not line.strip():
                yield name, data
                name, data = "", None


@pytest.fixture(scope="session")
def page_host():
    """The process whose children are the servers."""
    with closing(ForkHost(IMPORTS)) as host:
        yield host


@pytest.fixture(scope="module")
def page_server(page_host, tiny, tmp_path_factory):
    """Start `tokt label` on a free port: ``page_server("--annotator", "anna", mission=..., ...)``.

    Without `mission` it shows the tiny one; without `workspace` it gets an empty one. Whatever is
    still running at the end of the module is killed.
    """
    started = []

    def start(*arguments, mission=None, workspace=None):
        folder = workspace or tmp_path_factory.mktemp("page") / ".tokt"
        server = PageServer(page_host, mission or tiny.path, folder, tuple(map(str, arguments)))
        started.append(server)
        return server.start()

    yield start
    for server in started:
        if hasattr(server, "process") and server.process.poll() is None:
            server.kill()


class Watched:
    """What pages of one browser context did that they should not."""

    def __init__(self, context):
        self._own = ["data:", "blob:"]
        self._allowed = []
        self._faults = []
        context.on("request", self._request)
        context.on("console", self._console)
        context.on("weberror", lambda error: self._faults.append(f"uncaught: {error.error}"))

    def belongs(self, url):
        """Pages may ask the server of this address, too."""
        parts = urlsplit(url)
        self._own.append(f"{parts.scheme}://{parts.netloc}/")

    def allow(self, pattern):
        """Expect console errors that this regular expression finds, before they come."""
        self._allowed.append(pattern)

    def check(self):
        """Fail if anything was wrong since the last time; what was allowed is so no longer."""
        allowed = re.compile("|".join(self._allowed) or r"(?!)")
        wrong = [fault for fault in self._faults if not allowed.search(fault)]
        self._faults, self._allowed = [], []
        assert not wrong, "\n".join(wrong)

    def _request(self, request):
        if not request.url.startswith(tuple(self._own)):
            self._faults.append(f"request to somebody else: {request.url}")

    def _console(self, message):
        if message.type == "error":
            where = message.location
            self._faults.append(f"console: {message.text} ({where['url']}:{where['lineNumber']})")


def knows(page, what):
    """Whether a page knows this of its mission; `wait_for_function` waits for no promise."""
    return page.evaluate(
        f"() => import('/static/core/mission.js').then(({{ mission }}) => mission.{what})"
    )


def remembers(who):
    """A script by which a browser knows who works there, unless a person says otherwise."""
    identity = json.dumps(json.dumps({"who": who}))
    return f"if (origin !== 'null') localStorage['tokt.identity'] ??= {identity};"


_OFFLINE = r"Failed to load resource|ERR_CONNECTION|ERR_INTERNET|ERR_INCOMPLETE|ERR_EMPTY"


class Profiles:
    """Browser contexts, each with its own storage and with what its pages loaded."""

    def __init__(self, browser):
        self._browser = browser
        self._watched = {}

    def make(self, who):
        """A context that knows that `who` works there; with None it was never told."""
        context = self._browser.new_context()
        if who is not None:
            context.add_init_script(remembers(who))
        context.set_default_timeout(500 * MAX_S)
        self._watched[context] = Watched(context)
        return context

    def open(self, context, url, place, *patterns):
        """A page of a server, whose `load` event was awaited."""
        watched = self._watched[context]
        watched.belongs(url)
        for pattern in filter(None, patterns):
            watched.allow(pattern)
        page = context.new_page()
        page.goto(url + place)
        return page

    def check(self):
        """Fail if a page did what it should not."""
        for watched in self._watched.values():
            watched.check()

    def close(self, *contexts):
        for context in contexts or [*self._watched]:
            context.close()
            self._watched.pop(context).check()


@pytest.fixture(scope="module")
def profiles(browser, page_server):
    """Those of a module; its servers are there until they are closed."""
    made = Profiles(browser)
    yield made
    made.close()


@pytest.fixture(scope="module")
def annas(profiles):
    """Anna's browser, which the tests of a module share: what it loaded, it loads no more."""
    return profiles.make("anna")


@pytest.fixture
def browse(profiles, annas):
    """Open the page of a server: ``browse(server, "#/label/left/17", allow=...)``.

    It is a new tab of anna's browser; of one of their own for anybody else (``who="ben"``; None
    was never told who works there) and with `alone`. ``context=page.context`` opens
    another tab of the same browser. Any console error that `allow` (a regular expression) does not
    find, and any request to anybody but the server, fails the test when it ends; `offline` allows
    the errors of a browser whose server is away. When the test ends, anna's browser forgets what
    its pages kept, and they are closed.
    """
    opened, own = [], []

    def start(
        server, place="", *, who="anna", alone=False, context=None, allow=None, offline=False
    ):
        if context is None and (alone or who != "anna"):
            context = profiles.make(who)
            own.append(context)
        patterns = allow, _OFFLINE if offline else None
        page = profiles.open(context or annas, server.url, place, *patterns)
        opened.append(page)
        return page

    yield start
    for page in opened:
        if page.context is annas and not page.is_closed():
            page.evaluate("() => localStorage.clear()")
            page.close()
    if own:
        profiles.close(*own)
    profiles.check()
