"""A process that judges one frame the thesis's way and sends the verdict: the start-up baseline.

Run as ``python -m tokt.studies.speed.thesis_process MODEL FRAME PORT``: the model is a joblib
file of a LinearSVC on LBP (10, 5), and the verdict goes to 127.0.0.1 as one v1 datagram.
"""

from __future__ import annotations

import socket
import sys

import cv2
import joblib
import numpy as np

from tokt.inference.outputs.udp import encode_v1
from tokt.studies.baselines.thesis_texture import describe_lbp_10_5, judge


def main(model: str, frame: str, port: str) -> None:
    """Load, look, judge, send."""
    classifier = joblib.load(model)
    picture = np.asarray(cv2.imread(frame, cv2.IMREAD_ANYCOLOR), np.uint8)
    datagram = encode_v1(judge(picture, describe_lbp_10_5, classifier).verdict)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(datagram or b"", ("127.0.0.1", int(port)))


if __name__ == "__main__":
    main(*sys.argv[1:])
