"""Network addresses as users write them, their host looked up, and who may ask a server."""

import os
import re
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

from .atomic import write_text
from .errors import ToktError, UnavailableError

LOOPBACK_NAMES = frozenset({"127.0.0.1", "localhost", "[::1]"})
"""Host names of this computer in a Host header, for itself."""
_ANY_ADDRESS = ("0.0.0.0", "::")
_IP_ADDRESS = re.compile(r"\[[0-9a-f:.]+\]|\d{1,3}(\.\d{1,3}){3}")
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[^:\[\]]+)(?::(\d{1,5}))?")
_FOR_OWNER, _OTHERS = 0o600, 0o077
USER_INFO = re.compile(r"(://)[^/?#]*@")
"""Credentials in a URL, after its first group."""
# A password may have a / that ought to be quoted: up to the last @, be it a port and a path.
# A comma is of it unless another address follows.
_SHOWN_INFO = re.compile(r"(://)(?:[^/?#@\n]*:(?:(?!,\s*\w+:/)[^\n])*|[^/?#\s]*)@")
_MISTYPED_INFO = re.compile(r"^((?:rtsps?|rtspu|rtp|udp|https?):)/?[^/\n].*@", re.IGNORECASE)
"""Of a network address whose // is not there."""
# Some cameras want them in the query, or in the path: /user=admin&password=...
_SECRET = re.compile(
    r"((?:user|usr|login|pass|pwd|psw|token|auth|key|secret)\w*=)(?:(?!,\s*\w+:/)[^&/?#\s])*",
    re.IGNORECASE,
)
_ADDRESS = re.compile(r"(?:\[([^\]]+)\]|([^:\s]+)):(\d{1,5})")


def parse_address(text: str) -> tuple[str, int]:
    """Read ``HOST:PORT`` or ``[IPV6]:PORT``; ToktError if it is neither, or no port 1..65535."""
    match = _ADDRESS.fullmatch(text.strip())
    if match is None or not 1 <= int(match[3]) <= 65535:
        raise ToktError(f"not an address: {text!r} (write HOST:PORT, for example 127.0.0.1:1130)")
    return match[1] or match[2], int(match[3])


def resolve(host: str, port: int) -> tuple[socket.AddressFamily, Any]:
    """Look a host name up once: (address family, socket address); IPv4 where it has both.

    Programs such as LabVIEW listen on IPv4, and `localhost` may well be ::1 first.

    Raises ToktError if the name is not known.
    """
    # As bytes an address is looked up without the tables of international names.
    name = host.encode() if re.fullmatch(r"(\d{1,3}\.){3}\d{1,3}", host, re.ASCII) else host
    try:
        found = socket.getaddrinfo(name, port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise UnavailableError(f"host {host!r} cannot be found: {error}") from None
    family, _, _, _, address = min(found, key=lambda one: one[0] is not socket.AF_INET)
    return family, address


def host_header(text: str) -> tuple[str, int] | None:
    """The host name, in lower case, and the port of an HTTP request's Host header."""
    match = _HOST.fullmatch(text.lower())
    return None if match is None else (match[1], int(match[2] or 80))


def shown_host(host: str) -> str:
    """The host name in the URL of a server that listens on `host`, in lower case."""
    shown = (socket.gethostname() if host in _ANY_ADDRESS else host).lower()
    return f"[{shown}]" if ":" in shown else shown


def is_addressed(hosts: list[str], port: int, names: frozenset[str], any_address: bool) -> bool:
    """Return True if a request's Host headers are one that names a server on `port`.

    With `any_address` that may be any IP address: DNS rebinding needs a name.
    """
    name, given = (host_header(hosts[0]) if len(hosts) == 1 else None) or ("", 0)
    is_address = any_address and _IP_ADDRESS.fullmatch(name) is not None
    return given == port and (name in names or is_address)


def kept_token(file: Path) -> str:
    """A server's token, which outlasts a restart: a page that is open or bookmarked goes on.

    Made where there is none, or where others could read it. Where it cannot be kept for its owner
    alone, it is of this run only.
    """
    with suppress(OSError, UnicodeDecodeError):
        token = file.read_text("ascii").strip()
        if token and not (os.name == "posix" and file.stat().st_mode & _OTHERS):
            return token
    import secrets  # brings OpenSSL's hashes, which few commands have a use for

    token = secrets.token_urlsafe(18)
    with suppress(OSError):
        write_text(file, token + "\n", mode=_FOR_OWNER)
    return token


def without_credentials(text: str) -> str:
    """A URL, or words with one, as it may be shown and logged.

    A user and a password before ``@`` are left out; so is what query and path say of either.
    """
    text = _MISTYPED_INFO.sub(r"\1", text)
    return _SECRET.sub(r"\1...", _SHOWN_INFO.sub(r"\1", text)) if "://" in text else text
