"""Access to the server: host names, token, same-origin writes, and security headers.

A page in another tab can send requests to this computer, and by a name server that answers with
a loopback address (DNS rebinding) read what comes back. So the Host header must be a name of
ours, and a request that changes something must come from our own page. Another account on this
computer, or another computer, can send anything: so a request must show the token.
"""

import hashlib
import hmac
import re
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, unquote

from starlette.datastructures import Headers
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from tokt.features.common.address import LOOPBACK_NAMES, is_addressed

from .messages import error_response

TOKEN_FILE = "page-token"

MAX_BODY = 1_000_000  # bytes
UPLOAD, MAX_UPLOAD = "/api/import", 200_000_000
"""Where a file is the body, and how long it may be."""
SECURITY_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}
_COOKIE_S = 30 * 24 * 3600
_SAFE_METHODS = ("GET", "HEAD")
_OWN_SITES = ("same-origin", "none")
_LENGTH = re.compile(r"[0-9]{1,18}")
# Also for who has no token: the page that asks for it looks like the others.
_STYLE = "/static/core/page.css"
_PAGE = f"""<!doctype html>
<html lang="en">
  <head>
    <meta charset="utf-8" />
    <meta name="viewport" content="width=device-width, initial-scale=1" />
    <title>tokt</title>
    <link rel="icon" href="data:," />
    <link rel="stylesheet" href="{_STYLE}" />
  </head>
  <body>
    <main><dialog open aria-labelledby="what">%s</dialog></main>
  </body>
</html>
"""
_ASK = """
<form action="/">
  <h1 id="what">%s</h1>
  <p>Open the address that <code>tokt label</code> printed. It looks like
    <code>http://127.0.0.1:8118/?token=…</code></p>
  <p><label for="token">Or paste that address, or its token, here:</label></p>
  <div class="row">
    <input id="token" name="token" type="text" size="40" required autofocus autocomplete="off" />
    <button class="main" type="submit">Open</button>
  </div>
</form>
"""
_OTHER_HOST = """
<h1 id="what">The page is not served under this address</h1>
<p>Open the address that <code>tokt label</code> printed.</p>
"""


@dataclass(frozen=True)
class AccessRules:
    """The rules that a request must meet."""

    port: int
    """The one that the server listens on."""
    names: frozenset[str] = LOOPBACK_NAMES
    """Host names by which it may be addressed, in lower case, IPv6 addresses in brackets."""
    any_address: bool = False
    """Whether any IP address is such a name. A rebinding attack needs a name, not an address."""
    token: str | None = None
    """What must be shown with every request, or None."""
    tickets: set[str] = field(default_factory=set, compare=False)
    """What may be shown in its place once, to open the page."""

    def is_our_host(self, headers: list[str]) -> bool:
        """Whether a request's Host header addresses this server."""
        return is_addressed(headers, self.port, self.names, any_address=self.any_address)

    @property
    def cookie(self) -> str:
        """Name of the token's cookie. Browsers share cookies between the ports of a host."""
        return f"tokt_{self.port}"

    @property
    def cookie_value(self) -> str:
        """What the cookie holds: a token may have signs that a cookie cannot."""
        return hashlib.sha256(b"tokt" + (self.token or "").encode()).hexdigest()

    def is_token(self, given: str) -> bool:
        """Compare a token in a time that does not depend on where it differs."""
        return hmac.compare_digest(given.encode(), (self.token or "").encode())


class Access:
    """ASGI application around another one that lets through what `AccessRules` allow."""

    def __init__(self, app: ASGIApp, rules: AccessRules) -> None:
        self._app = app
        self._rules = rules

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or pass it on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                extra = [(name.encode(), text.encode()) for name, text in SECURITY_HEADERS.items()]
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        answer = self._refuse(scope, Headers(scope=scope))
        await (answer or self._app)(scope, receive, send_with_headers)

    def _refuse(self, scope: Scope, headers: Headers) -> Response | None:
        hosts = headers.getlist("host")
        if not self._rules.is_our_host(hosts):
            words = "this server is not addressed by that host name"
            return _refusal(headers, 403, words, _OTHER_HOST)
        # The page itself may be opened by a link anywhere; all else only our own page asks for.
        if scope["path"] != "/" and headers.get("sec-fetch-site", "none") not in _OWN_SITES:
            return error_response(403, "a page of another site may not ask for anything here")
        if scope["method"] not in _SAFE_METHODS:
            own_origin = f"http://{hosts[0].lower()}"
            refused = _refuse_write(headers, own_origin, scope["path"] == UPLOAD)
            if refused is not None:
                return refused
        return None if self._rules.token is None else self._ask_token(scope, headers)

    def _ask_token(self, scope: Scope, headers: Headers) -> Response | None:
        query = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
        if scope["path"] == "/" and scope["method"] == "GET" and any(map(self._is_shown, query)):
            answer = RedirectResponse("/", status_code=303)
            # Not "strict": a colleague's link, followed from a mail, must find the cookie. What
            # other sites may ask for is refused by where the request comes from.
            cookie = (self._rules.cookie, self._rules.cookie_value)
            answer.set_cookie(*cookie, max_age=_COOKIE_S, httponly=True, samesite="lax")
            answer.headers["cache-control"] = "no-store"
            return answer
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer" and self._rules.is_token(given.strip()):
            return None
        if hmac.compare_digest(
            _cookie(headers, self._rules.cookie).encode(), self._rules.cookie_value.encode()
        ):
            return None
        if scope["path"] == _STYLE:
            return None
        words = "this page needs its token: open the address that tokt label printed"
        asked = "That was not the token" if query else "This page needs its token"
        return _refusal(headers, 401, words, _ASK % asked)

    def _is_shown(self, given: str) -> bool:
        """Whether somebody gave the token, or pasted the whole address that holds it."""
        if given in self._rules.tickets:
            self._rules.tickets.discard(given)
            return True
        pasted = unquote(given.strip().rpartition("?token=")[2])
        return self._rules.is_token(given) or self._rules.is_token(pasted)


def _refusal(headers: Headers, status: int, words: str, page: str) -> Response:
    """The page for who looks at it in a browser, an error of one line for a program."""
    if "text/html" in headers.get("accept", ""):
        return HTMLResponse(_PAGE % page, status, {"cache-control": "no-store"})
    return error_response(status, words)


def _refuse_write(headers: Headers, own_origin: str, upload: bool) -> Response | None:
    origin = headers.get("origin")
    if origin is not None and origin.lower() != own_origin:
        return error_response(403, "a page of another origin may not change anything here")
    # Neither is a kind that a page of another site may send without asking first.
    kind = "application/octet-stream" if upload else "application/json"
    if headers.get("content-type", "").partition(";")[0].strip().lower() != kind:
        return error_response(415, f"the body must be {kind}")
    length = headers.get("content-length", "")
    # Where both are given the parts of the body count, and nothing limits them.
    if _LENGTH.fullmatch(length) is None or "transfer-encoding" in headers:
        return error_response(411, "the body's length must be told")
    longest = MAX_UPLOAD if upload else MAX_BODY
    if int(length) > longest:
        return error_response(413, f"the body is longer than {longest} bytes")
    return None


def _cookie(headers: Headers, name: str) -> str:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(name)
    except CookieError:
        return ""
    return found.value if found else ""
