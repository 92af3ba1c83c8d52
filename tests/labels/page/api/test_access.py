"""What the server refuses, asked over real sockets as an attacker's page would."""

import http.client
import json
import os
import socket
from contextlib import closing
from urllib.parse import urlencode, urlsplit

import pytest

from tests.inference.test_faults import hold_row
from tokt.features.common.address import kept_token

CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
SEEN = json.dumps({"who": "anna", "camera": "left", "frame": 1}).encode()
JSON = {"Content-Type": "application/json"}
STRANGER = {"Authorization": ""}


@pytest.fixture(scope="module")
def server(page_server):
    return page_server()


@pytest.fixture(scope="module")
def guarded(page_server):
    """A server that needs a token with signs that neither a URL nor a cookie can hold as is."""
    return page_server("--host", "0.0.0.0", "--token", 's&cret; "1"')


def _raw(server, text):
    """Send bytes that http.client would not."""
    with closing(socket.create_connection(("127.0.0.1", server.port), 10)) as connection:
        connection.sendall(text.encode("latin-1"))
        answer = http.client.HTTPResponse(connection)
        answer.begin()
        return answer.status, answer.headers, answer.read()


def _safe(headers):
    return (
        headers["Content-Security-Policy"] == CSP
        and headers["X-Content-Type-Options"] == "nosniff"
        and headers["Referrer-Policy"] == "no-referrer"
        and headers["Cross-Origin-Resource-Policy"] == "same-origin"
        and headers["Access-Control-Allow-Origin"] is None
        and headers["Server"] is None
    )


@pytest.mark.parametrize(
    "host",
    [
        *("attacker.example", "attacker.example:{port}", "127.0.0.1.attacker.example:{port}"),
        *("localhost:{port}.attacker.example", "127.0.0.1:{port}, attacker.example"),
        *("localhost.:{port}", "user@127.0.0.1:{port}", "127.0.0.2:{port}", "[::2]:{port}"),
        *("127.0.0.1", "127.0.0.1:1", "127.0.0.1:" + "1" * 5000, ""),
    ],
)
def test_other_host_names_are_refused(server, host):
    for path in ("/", "/api/mission", "/static/index.html", "/nothing"):
        answer = server.request("GET", path, headers={"Host": host.format(port=server.port)})
        assert answer.status in (400, 403), path
        assert b"ocean" not in answer.body and b"<html" not in answer.body
    said = "refused with code 403; no version of Python is told"
    hold_row("the labelling page is asked for by another host name", said, "nothing")


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "LOCALHOST", "[::1]"])
def test_own_host_names(server, host):
    answer = server.request("GET", "/api/mission", headers={"Host": f"{host}:{server.port}"})
    assert answer.status == 200


def test_no_host_and_two_hosts_are_refused(server):
    own = f"Host: 127.0.0.1:{server.port}\r\n"
    assert _raw(server, "GET /api/mission HTTP/1.0\r\n\r\n")[0] in (400, 403)
    two = f"GET /api/mission HTTP/1.1\r\n{own}Host: attacker.example\r\n\r\n"
    assert _raw(server, two)[0] in (400, 403)
    absolute = f"GET http://attacker.example/api/mission HTTP/1.1\r\n{own}\r\n"
    assert b"ocean" not in _raw(server, absolute)[2]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Content-Type": "application/json"}, 200),
        ({"Content-Type": "application/json; charset=utf-8"}, 200),
        ({"Content-Type": "application/json", "Origin": "http://127.0.0.1:{port}"}, 200),
        ({"Content-Type": "application/json", "Sec-Fetch-Site": "same-origin"}, 200),
        ({"Content-Type": "application/json", "Origin": "http://attacker.example"}, 403),
        ({"Content-Type": "application/json", "Origin": "https://127.0.0.1:{port}"}, 403),
        ({"Content-Type": "application/json", "Origin": "http://127.0.0.1:1"}, 403),
        ({"Content-Type": "application/json", "Origin": "http://localhost:{port}"}, 403),
        ({"Content-Type": "application/json", "Origin": "null"}, 403),
        ({"Content-Type": "application/json", "Sec-Fetch-Site": "cross-site"}, 403),
        ({"Content-Type": "application/json", "Sec-Fetch-Site": "same-site"}, 403),
        ({"Content-Type": "text/plain"}, 415),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415),
        ({"Content-Type": "text/plain; application/json"}, 415),
        ({}, 415),
    ],
)
def test_only_our_own_page_may_write(server, headers, status):
    sent = {name: text.format(port=server.port) for name, text in headers.items()}
    answer = server.request("POST", "/api/seen", SEEN, sent)
    assert answer.status == status, answer.body
    assert _safe(answer.headers)
    if status != 200:
        assert list(answer.json) == ["error"]


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_pages_of_other_sites_may_only_link_to_our_page(server, site):
    headers = {"Sec-Fetch-Site": site}
    assert server.request("GET", "/", headers=headers).status == 200
    for path in ("/api/mission", "/api/picture/left/1", "/static/index.html"):
        assert server.request("GET", path, headers=headers).status == 403, path


@pytest.mark.parametrize("method", ["PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "BREW"])
def test_other_methods_do_nothing(server, method):
    headers = {**JSON, "Origin": "http://attacker.example"}
    assert server.request(method, "/api/seen", SEEN, headers).status == 403
    answer = server.request(method, "/api/seen", SEEN, JSON)
    assert answer.status == 405 and _safe(answer.headers)


def test_large_and_endless_bodies_are_refused(server):
    own = f"Host: 127.0.0.1:{server.port}\r\nContent-Type: application/json\r\n"
    start = f"POST /api/actions HTTP/1.1\r\n{own}"
    for length, status in (("1000001", 413), ("9" * 18, 413), ("-1", 400), ("1e3", 400)):
        assert _raw(server, f"{start}Content-Length: {length}\r\n\r\n")[0] == status
    assert _raw(server, f"{start}Transfer-Encoding: chunked\r\n\r\n5\r\n")[0] == 411
    both = f"{start}Content-Length: 9\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n"
    assert _raw(server, both)[0] == 411
    assert _raw(server, f"{start}\r\n")[0] == 411
    body = json.dumps({"kind": "x" * 990_000}).encode()
    assert server.request("POST", "/api/actions", body, JSON).status == 400


@pytest.mark.parametrize(
    "path",
    [
        *("/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fapp.py"),
        *("/static/..%5capp.py", "/static/....//app.py", "/static//etc/passwd"),
        *("/static/%2fetc%2fpasswd", "/static/index.html%00.js", "/static/" + "a/" * 3000),
        *("/static/", "/static", "/../../etc/passwd", "/api/picture/left/../../../etc/passwd"),
        *("/api/picture/left/..%2f..%2fetc%2fpasswd", "/api/picture/..%2fleft/1"),
        *("/api/picture/left/1%00", "/api/picture/left/-1", "/api/picture/left/9999"),
        *("/api/picture/left/99999999999999999999", "/api/picture/right/1"),
        *("/api/thumb/left/%2e%2e", "/api/patches?cells=left:1:0,../../etc/passwd"),
        *("/api/patches?cells=left:1:100", "/api/labels?camera=left&frames=../1"),
        *("/docs", "/redoc", "/openapi.json"),
    ],
)
def test_nothing_outside_is_served(server, path):
    answer = server.request("GET", path)
    assert answer.status in (307, 400, 404), answer.body
    assert b"root:" not in answer.body and b"FastAPI" not in answer.body
    assert _safe(answer.headers)
    if answer.status != 307:
        assert list(answer.json) == ["error"] and "\n" not in answer.json["error"]


def test_every_answer_has_the_headers(server):
    for path in ("/", "/static/start/main.js", "/api/mission", "/api/picture/left/1"):
        answer = server.request("GET", path)
        assert answer.status == 200 and _safe(answer.headers), path
    assert server.request("GET", "/api/mission").headers["Cache-Control"] == "no-store"


def test_pictures_of_another_mission_are_never_taken_for_these(server):
    version = server.get("/api/mission")["pictures"]
    for path in ("picture/left/1?", "thumb/left/1?", "patches?cells=left:1:0&"):
        for given, kept in ((f"v={version}", True), ("", False)):
            answer = server.request("GET", f"/api/{path}{given}")
            assert answer.status == 200
            assert ("immutable" in answer.headers["Cache-Control"]) is kept
            assert ("no-store" in answer.headers["Cache-Control"]) is not kept
        answer = server.request("GET", f"/api/{path}v=0")
        assert answer.status == 409 and "no-store" in answer.headers["Cache-Control"]
    assert server.request("GET", "/api/labels?camera=left&frames=1&v=0").status == 409


def test_page_files_are_asked_for_each_time(server):
    first = server.request("GET", "/static/start/main.js")
    assert first.headers["Content-Type"].startswith("text/javascript")
    assert first.headers["Cache-Control"] == "no-cache"
    known = {"If-None-Match": first.headers["ETag"]}
    for path, status in (("/static/start/main.js", 304), ("/static/core/api.js", 200), ("/", 200)):
        assert server.request("GET", path, headers=known).status == status, path


def test_token(guarded):
    parts = urlsplit(guarded.url)
    assert parts.query == "token=s%26cret%3B%20%221%22"
    for path in (
        "/",
        "/?token=secret",
        "/?token=",
        "/static/start/main.js",
        "/api/mission?token=s",
    ):
        answer = guarded.request("GET", path, headers=STRANGER)
        assert answer.status == 401 and _safe(answer.headers), path
        assert list(answer.json) == ["error"]
    assert guarded.request("POST", "/api/seen", SEEN, {**JSON, **STRANGER}).status == 401
    for wrong in ("Bearer", "Bearer ", "Bearer x", 'Basic s&cret; "1"', "Bearer \xff"):
        headers = {"Authorization": wrong}
        assert guarded.request("GET", "/api/mission", headers=headers).status == 401
    right = {"Authorization": 'Bearer s&cret; "1"'}
    assert guarded.request("GET", "/api/mission", headers=right).status == 200


def test_token_becomes_a_cookie(guarded):
    answer = guarded.request("GET", f"/?{urlsplit(guarded.url).query}")
    assert (answer.status, answer.headers["Location"]) == (303, "/")
    cookie, *attributes = answer.headers["Set-Cookie"].split("; ")
    assert {"httponly", "samesite=lax"} <= {attribute.lower() for attribute in attributes}
    assert "cret" not in cookie and str(guarded.port) in cookie
    known = {**STRANGER, "Cookie": cookie}
    assert guarded.request("GET", "/", headers=known).status == 200
    assert guarded.request("POST", "/api/seen", SEEN, {**JSON, **known}).status == 200
    for wrong in (cookie[:-1], cookie + "0", "a=b", cookie.replace("=", "x="), ";;\x01="):
        headers = {**STRANGER, "Cookie": wrong}
        assert guarded.request("GET", "/", headers=headers).status == 401, wrong


def test_a_browser_is_told_what_to_do(guarded):
    html = {**STRANGER, "Accept": "text/html,*/*;q=0.8"}
    other = {**html, "Host": f"attacker.example:{guarded.port}"}
    for headers, path, status, words in (
        (html, "/", 401, b"This page needs its token"),
        (html, "/api/mission", 401, b"This page needs its token"),
        (html, "/?token=%3Cb%3E", 401, b"That was not the token"),
        (other, "/", 403, b"not served under this address"),
    ):
        answer = guarded.request("GET", path, headers=headers)
        assert (answer.status, answer.headers.get_content_type()) == (status, "text/html"), path
        assert _safe(answer.headers) and answer.headers["Cache-Control"] == "no-store"
        assert words in answer.body and b"tok" in answer.body and b"<b>" not in answer.body
        assert b"tiny" not in answer.body and b"s&cret" not in answer.body
    assert guarded.request("GET", "/static/core/page.css", headers=STRANGER).status == 200
    for pasted in ('s&cret; "1"', guarded.url, f" {guarded.url} "):
        query = urlencode({"token": pasted})
        assert guarded.request("GET", f"/?{query}", headers=html).status == 303, pasted


def test_without_a_token(page_server):
    server = page_server("--no-token")
    assert urlsplit(server.url).query == "" and not (server.workspace / "page-token").exists()
    assert server.request("GET", "/api/mission").status == 200


@pytest.mark.skipif(os.name != "posix", reason="no modes of files elsewhere")
def test_the_token_outlasts_a_restart_and_is_its_owners_alone(page_server, tmp_path):
    server = page_server(workspace=tmp_path / ".tokt")
    token, first = tmp_path / ".tokt" / "page-token", server.url
    assert token.stat().st_mode & 0o777 == 0o600
    assert server.request("GET", "/api/mission", headers=STRANGER).status == 401
    server.kill()
    assert server.start().url == first
    server.kill()
    for spoil in (lambda: token.chmod(0o644), lambda: token.write_bytes(b"\xff"), token.unlink):
        spoil()
        said = token.read_bytes().strip() if token.exists() else b""
        assert kept_token(token) not in (first.partition("=")[2], said.decode("latin-1"))
        assert token.stat().st_mode & 0o777 == 0o600


def test_an_open_server_answers_to_addresses_and_its_own_name(guarded):
    right = {"Authorization": 'Bearer s&cret; "1"'}
    port = guarded.port
    for host in ("192.0.2.7", "[2001:db8::1]", "localhost", socket.gethostname()):
        headers = {**right, "Host": f"{host}:{port}"}
        assert guarded.request("GET", "/api/mission", headers=headers).status == 200, host
    for host in ("attacker.example", "192.0.2.7.attacker.example"):
        headers = {**right, "Host": f"{host}:{port}"}
        assert guarded.request("GET", "/api/mission", headers=headers).status == 403, host
