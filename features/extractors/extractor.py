"""Extractors: a frame and a grid become one feature row a patch, as a JSON spec says.

Training and the runtime both call `Extractor.describe`, so they cannot differ. A spec is all
there is to know about an extractor; two equal specs give equal features.

Specs::

    {"name": "lbp", "version": 1, "points": 10, "radius": 5, "border": "patch", "image": IMAGE}
    {"name": "lbp", "version": 2, "points": 8, "radius": 5, "border": "frame",
     "sampling": "nearest", "image": IMAGE}
    {"name": "haralick", "version": 1, "ignore_zeros": false, "image": IMAGE}
    {"name": "haralick", "version": 2, "ignore_zeros": false, "scale": "log", "image": IMAGE}
    {"name": "structure", "version": 1, "image": IMAGE}
    {"name": "lines", "version": 1, "samples": [8, 16, 32], "image": IMAGE}
    {"name": "moments", "version": 1, "image": IMAGE}
    {"name": "gradients", "version": 1, "smooth": [1, 3, 5, 9]}
    {"name": "colour", "version": 1, "cells": 9}
    {"name": "colour", "version": 2, "cells": 9, "gray": true}
    {"name": "place", "version": 1}
    {"name": "relative", "version": 1, "parts": [SPEC, ...], "quietest": 0.3}
    {"name": "water_contrast", "version": 1, "parts": [SPEC, ...], "quietest": 0.3, "cells": 9}
    {"name": "context", "version": 1, "part": SPEC, "statistic": "mean"}
    {"name": "join", "version": 1, "parts": [SPEC, SPEC, ...]}

A join takes contexts and a context may be of a join, but nothing stands inside its own kind.
Gradients, colour and place have no image; relative and water_contrast take away what the frame's
own water shows.

``IMAGE`` says how the frame becomes the picture of up to 256 levels that is looked at::

    {"resize": "area", "gray": "bt601"}
    {"resize": "area_deep", "gray": "bt601", "smooth": 1,
     "flatten": {"window": 61, "by": "frame"}, "gain": 8, "levels": 256}

The first, plain one is OpenCV's INTER_AREA to the grid's width, then BGR to gray, each rounded to
whole grey levels. The second keeps 1/256 grey level until the end: see
`tokt.features.kernels.quantization`.
"""

from .frame_pictures import gray_picture as gray_picture
from .named_extractors import extractor_named as extractor_named
from .spec import build_extractor as build_extractor
from .textures import HARALICK_NAMES as HARALICK_NAMES
from .textures import Extractor as Extractor
from .textures import Glcm as Glcm
from .textures import Join as Join
from .textures import Lbp as Lbp
