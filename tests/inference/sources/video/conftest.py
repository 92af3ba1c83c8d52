"""Encoded films that several tests read, made once."""

import pytest

from .encoding import decoded, encode
from .packets import rtp_packets
from .v4l2_device import device, stand_in  # noqa: F401


@pytest.fixture(scope="session", params=["h264", "h265"])
def codec(request):
    return request.param


@pytest.fixture(scope="session")
def film(codec):
    """Two seconds of encoded pictures, a key picture each half second."""
    return encode(codec, 60, key_every=15)


@pytest.fixture(scope="session")
def truth(film, codec):
    """By number: the pictures that the film decodes to where nothing is lost."""
    return dict(decoded(film, codec))


@pytest.fixture(scope="session")
def capture(film, codec):
    """The film's RTP packets."""
    return rtp_packets(film, codec)
