"""Network addresses as users write them, and looking their host up."""

import re
import socket
from typing import Any

from .errors import ToktError

_ADDRESS = re.compile(r"(?:\[([^\]]+)\]|([^:\s]+)):(\d{1,5})")


def parse_address(text: str) -> tuple[str, int]:
    """Read ``HOST:PORT`` (or ``[IPV6]:PORT``).

    Raises
    ------
    ToktError
        If it is neither, or the port is not 1..65535.
    """
    match = _ADDRESS.fullmatch(text.strip())
    if match is None or not 1 <= int(match[3]) <= 65535:
        raise ToktError(f"not an address: {text!r} (write HOST:PORT, for example 127.0.0.1:1130)")
    return match[1] or match[2], int(match[3])


def resolve(host: str, port: int) -> tuple[socket.AddressFamily, Any]:
    """Look a host name up once: (address family, socket address); IPv4 where it has both.

    Programs such as LabVIEW listen on IPv4, and `localhost` may well be ::1 first.

    Raises
    ------
    ToktError
        If the name is not known.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise ToktError(f"host {host!r} cannot be found: {error}") from None
    family, _, _, _, address = min(found, key=lambda one: one[0] is not socket.AF_INET)
    return family, address
