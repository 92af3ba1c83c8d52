"""USB cameras: their names and formats, as their drivers say (Video4Linux)."""

import os
import struct
import sys
from contextlib import suppress

_QUERYCAP, _ENUM_FMT = 0x80685600, 0xC0405602  # linux/videodev2.h
_CAPTURE, _MAX_LISTED = 1, 64
_NAMES = {b"MJPG": "mjpeg", b"YUYV": "yuyv", b"H264": "h264"}  # as addresses have them


def describe_camera(device: str) -> tuple[str, list[str]]:
    """What a camera is called, and its formats; none of a device that sends no pictures.

    OSError if it cannot be opened, or is no such device.
    """
    if sys.platform != "linux":
        raise OSError("Video4Linux is Linux's")
    import fcntl

    opened, formats = os.open(device, os.O_RDWR | os.O_NONBLOCK), []
    try:
        about = fcntl.ioctl(opened, _QUERYCAP, bytes(104))
        if int.from_bytes(about[88:92], sys.byteorder) & _CAPTURE:
            with suppress(OSError):  # there is no more
                for index in range(_MAX_LISTED):
                    asked = struct.pack("=II56x", index, 1)  # V4L2_BUF_TYPE_VIDEO_CAPTURE
                    code = fcntl.ioctl(opened, _ENUM_FMT, asked)[44:48]
                    formats.append(_NAMES.get(code) or code.decode("ascii", "replace"))
    finally:
        os.close(opened)
    return about[16:48].split(b"\0")[0].decode("utf-8", "replace"), formats
