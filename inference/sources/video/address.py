"""Addresses of video as users write them: network streams and USB cameras."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Self
from urllib.parse import parse_qsl, unquote, urlsplit

from tokt.features.common.address import USER_INFO, without_credentials
from tokt.features.common.errors import ToktError

USER_VARIABLE, PASSWORD_VARIABLE = "TOKT_SOURCE_USER", "TOKT_SOURCE_PASSWORD"
"""Environment variables with the credentials of an address that has none."""

SCHEMES = ("rtsp", "rtspu", "rtsps", "rtp", "udp", "http", "https", "v4l2")
_OPTIONS = {"rtp": {"codec"}, "udp": set[str](), "v4l2": {"size", "rate", "format"}}
_VALUES = {
    "codec": ("h264|h265", "h264 or h265"),
    "format": ("yuyv|mjpeg|h264", "yuyv or mjpeg or h264"),
    "size": (r"[1-9]\d{0,4}x[1-9]\d{0,4}", "WIDTHxHEIGHT, such as 1280x720"),
    "rate": (r"[1-9]\d{0,3}(\.\d{1,3})?", "frames per second, such as 30"),
}
_NEXT = re.compile(rf",(?=\s*(?:{'|'.join(SCHEMES)}):)", re.IGNORECASE)


def is_video_source(text: str) -> bool:
    """Whether this names network video or a USB camera, and not a folder or a file."""
    return text.partition(":")[0].lower() in SCHEMES and ":" in text


@dataclass(frozen=True)
class VideoAddress:
    """One camera's video."""

    scheme: str  # one of `SCHEMES`
    name: str  # what is shown: the address without credentials
    url: str = field(repr=False)  # as the user wrote it, without user and password
    host: str = ""  # to connect to; for rtp and udp this computer's to listen on, or empty for any
    port: int | None = None
    user: str = field(default="", repr=False)
    password: str = field(default="", repr=False)
    options: Mapping[str, str] = field(default_factory=dict)  # after the ? of rtp, udp and v4l2

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read one; ToktError, which holds no credentials, if it cannot be meant."""
        shown = without_credentials(text)
        scheme, _, rest = text.partition(":")
        scheme = scheme.lower()
        if scheme != "v4l2" and not rest.startswith("//"):
            raise ToktError(f"a source of this kind begins with {scheme}://")
        try:
            parts = urlsplit(f"//{rest}" if scheme == "v4l2" else f"{scheme}:{rest}")
            port = None if scheme == "v4l2" else parts.port
            host = parts.hostname or ""
        except ValueError as error:
            words = "no such address"
            if "port" in str(error).lower():
                words = "its port is no number up to 65535, or a password's / ? # are not quoted"
            raise ToktError(f"source {shown}: {words}") from None
        known = _OPTIONS.get(scheme)
        options = {} if known is None else dict(parse_qsl(parts.query, keep_blank_values=True))
        url = USER_INFO.sub(r"\1", f"{scheme}:{rest}")
        user, password = unquote(parts.username or ""), unquote(parts.password or "")
        made = cls(scheme, shown, url, host, port, user, password, options)
        if wrong := made._wrong(known):
            raise ToktError(f"source {shown}: {wrong}")
        return made

    def _wrong(self, known: set[str] | None) -> str:
        """What cannot be meant, in words."""
        if self.scheme in ("rtp", "udp") and not self.port:
            return f"write the port to listen on, such as {self.scheme}://:5600"
        if self.scheme.startswith(("rtsp", "http")) and not self.host:
            return "it names no host"
        if self.scheme == "v4l2" and not self.device.startswith("/"):
            return "write the device, such as v4l2:/dev/video0"
        if known is not None and (unknown := sorted(set(self.options) - known)):
            have = ", ".join(sorted(known)) or "none"
            return f"unknown option {unknown[0]!r} (it has {have})"
        for name, (pattern, words) in _VALUES.items():
            if name in self.options and not re.fullmatch(pattern, value := self.options[name]):
                return f"{name} is {words}, not {value!r}"
        return ""

    @property
    def device(self) -> str:
        """The device file of a USB camera."""
        return self.url.partition(":")[2].partition("?")[0]

    def with_environment(self) -> Self:
        """The same with the environment's credentials, where the address has none of its own."""
        if self.user or self.password:
            return self
        user, password = (os.environ.get(name, "") for name in (USER_VARIABLE, PASSWORD_VARIABLE))
        return replace(self, user=user, password=password)


def parse_video_sources(text: str) -> list[VideoAddress]:
    """The addresses of one camera, or of a left and a right one with a comma between.

    ToktError if there are more than two, the same twice, or one cannot be meant.
    """
    addresses = [VideoAddress.parse(each.strip()) for each in _NEXT.split(text)]
    if len(addresses) > 2:
        raise ToktError(f"a source is one camera or two, not {len(addresses)}")
    if len({each.url for each in addresses}) < len(addresses):
        raise ToktError(f"the left and the right camera are both {addresses[0].name}")
    return addresses
