"""A registered model as MLflow loads and serves it: the pyfunc whose data is the bundle.

MLflow calls `_load_pyfunc` of this module, as the model's ``loader_module``. The bundle is read
with all its checks; nothing is unpickled.

A frame is an array of uint8, shape (height, width) or (height, width, 3) in BGR order. Or it is a
`pathlib.Path`, the bytes of an image file, their base64, or a path as text. Text with a dot
is a path, as base64 has none. A caller over the network can send text alone. So text is read as a
path only below the folder that the environment variable ``TOKT_FRAMES`` names.
"""

import base64
import binascii
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

# Before the first import of cv2: a kilobyte from the network can say that it has 2**30 pixels.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "100000000")

import cv2
import numpy as np
import pandas as pd
import yaml
from mlflow.exceptions import MlflowException
from mlflow.models import ModelSignature
from mlflow.types import ColSpec, DataType, ParamSchema, ParamSpec, Schema, TensorSpec
from mlflow.types.schema import Array
from numpy.typing import NDArray

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError, os_errors_as
from tokt.features.frames.image_file import decode_image
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement, SinglePolicy
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import Bundle, read_bundle

__all__ = ["frames_array"]

LOADER_MODULE = __name__
FOLDER_VARIABLE = "TOKT_FRAMES"
COLUMN = "frame"
_INDEPENDENT = "independent"
_KINDS = {
    **dict.fromkeys(("status", "x", "y"), DataType.long),
    "box": Array(DataType.long),
    "mean": DataType.double,
    **dict.fromkeys(("reason", "health", "model"), DataType.string),
    "patches": Array(DataType.boolean),
    "decision_values": Array(Array(DataType.double)),
    "mask": DataType.string,
}
_AS_JUDGED = ("status", "x", "y", "mean", "health", "model")
SIGNATURE = ModelSignature(
    Schema([TensorSpec(np.dtype(object), (-1,), COLUMN)]),
    Schema([ColSpec(kind, name, required=name == "status") for name, kind in _KINDS.items()]),
    ParamSchema([ParamSpec(_INDEPENDENT, DataType.boolean, False)]),
)
"""Of every registered model. MLflow lets any array, and any column of text, pass as ``object``."""


def frames_array(frames: Iterable[Any]) -> NDArray[np.object_]:
    """Frames of any kind and size as one array of objects, shape (n,), which MLflow lets pass."""
    return np.fromiter(frames, object)


class TextureModel:
    """A model as MLflow's pyfunc: frames in, a row for each frame out."""

    def __init__(self, bundle: Bundle) -> None:
        self.bundle = bundle

    def get_raw_model(self) -> Bundle:
        """The bundle, as MLflow's users ask for it."""
        return self.bundle

    def predict(self, model_input: Any, params: dict[str, Any] | None = None) -> pd.DataFrame:
        """Judge frames as policy ``texture`` of `tokt run` judges them.

        The frames of one call are one dive, in their order: the frame rule and moving water
        remember earlier frames. Two calls share nothing.

        Parameters
        ----------
        model_input : array, pandas.DataFrame, list or mapping
            One frame, or an array of frames, shape (n, height, width) or (n, height, width, 3).
            Colour is BGR: nothing here can tell RGB, whose verdicts are wrong.
            Or a list, an array of objects, or column ``frame`` of a table: frames of any kind.
        params : dict, optional
            With ``independent``: True each frame is a dive's only frame.

        Returns
        -------
        pandas.DataFrame
            A row a frame; None is what is not known. ``status`` (1 obstacle, 0 clear, -1 unknown),
            ``x``, ``y``, ``box``, ``mean``, ``reason``, ``health`` and ``model`` as in the log.
            ``patches`` (n_patches,) says row by row of the grid which are obstacles;
            ``decision_values`` (n_patches, n_outputs) are less the boundary. ``mask`` is a PNG
            file in base64, 255 where an obstacle was seen.

        Raises
        ------
        mlflow.exceptions.MlflowException
            If something is no frame: one line. A file that cannot be read is an unknown verdict.
        """
        alone = bool((params or {}).get(_INDEPENDENT, False))
        policy, rows = SinglePolicy(TextureDetector(self.bundle)), []
        for number, given in enumerate(_listed(model_input)):
            if alone:
                policy = SinglePolicy(TextureDetector(self.bundle))
            picture, fault = _picture(given)
            judged = policy.judge(Frame(number, 0.0, picture, None, left_fault=fault))
            rows.append(self._row(judged))
        return pd.DataFrame(rows, columns=list(_KINDS), dtype=object)

    def _row(self, judged: Judgement) -> dict[str, Any]:
        verdict, values, patches = judged.verdict, judged.decision_values, None
        if values is not None:
            patches = self.bundle.model.obstacle_patches(values).tolist()
        return {
            **{name: getattr(verdict, name) for name in _AS_JUDGED},
            "box": verdict.box and list(verdict.box),
            "reason": verdict.reason.value,
            "patches": patches,
            "decision_values": None if values is None else values.tolist(),
            "mask": None if judged.mask is None else _png_text(judged.mask),
        }


def _load_pyfunc(data_path: str) -> TextureModel:
    """The model of a bundle file, for MLflow.

    ToktError if the bundle fails a check, or is another version's than MLflow loads it for.
    """
    bundle = read_bundle(data_path)
    _check_number(bundle, Path(data_path).parents[1] / "registered_model_meta")
    return TextureModel(bundle)


def _check_number(bundle: Bundle, asked_for: Path) -> None:
    """Refuse a bundle of another number of the same model; a copy under another name is none."""
    if not asked_for.is_file():
        return  # loaded by its id, or from a folder
    about = yaml.safe_load(asked_for.read_text("utf-8"))
    label = f"{about['model_name']}/{about['model_version']}"
    if about["model_name"] == bundle.name and label != bundle.label:
        raise ToktError(f"model {label}: its bundle is of {bundle.label}")


def _listed(model_input: Any) -> list[Any]:
    """The frames of a call, in their order."""
    if isinstance(model_input, pd.DataFrame | Mapping):
        if COLUMN not in model_input:
            raise _wrong(f"there is no column {COLUMN!r}")
        model_input = model_input[COLUMN]
    if isinstance(model_input, np.ndarray) and not model_input.ndim:
        model_input = model_input.item()  # what the server makes of one text
    shape = model_input.shape if isinstance(model_input, np.ndarray) else ()
    if isinstance(model_input, str | bytes | Path) or (len(shape), *shape[2:]) in ((2,), (3, 3)):
        return [model_input]
    if isinstance(model_input, Iterable):
        return list(model_input)
    raise _wrong(f"{type(model_input).__name__} is no list of frames")


def _picture(given: Any) -> tuple[U8 | None, Fault]:
    """A frame's pixels, or why there are none."""
    if isinstance(given, np.ndarray) and given.dtype == np.uint8 and given.ndim in (2, 3):
        return given, NO_FAULT
    try:
        if isinstance(given, bytes):
            return decode_image(given, COLUMN), NO_FAULT
        if isinstance(given, str) and "." not in given:
            return decode_image(_decoded(given), COLUMN), NO_FAULT
        if isinstance(given, str | Path):
            with os_errors_as(str(given), FrameError):  # a caller far away learns no place
                data = (given if isinstance(given, Path) else _permitted(given)).read_bytes()
            return decode_image(data, str(given)), NO_FAULT
    except FrameError as error:
        return None, Fault(Reason.UNREADABLE, str(error))
    kind = type(given).__name__
    if isinstance(given, np.ndarray):
        kind = f"an array of {given.dtype} and shape {given.shape}"
    raise _wrong(f"{kind} is no frame (an 8-bit array, a path or base64)")


def _permitted(path: str) -> Path:
    """A path that came as text, from anywhere, where it may be read."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder:
        raise _wrong(f"paths as text are not read unless {FOLDER_VARIABLE} names their folder")
    try:
        root = Path(folder).resolve()
        found = (root / path).resolve()
    except (OSError, ValueError, RuntimeError):  # a null sign in it, links in a circle
        raise _wrong("a path that cannot be followed") from None
    if not found.is_relative_to(root):
        raise _wrong(f"a path is outside the folder that {FOLDER_VARIABLE} names")
    return found


def _decoded(text: str) -> bytes:
    """The bytes of base64, also as a ``data:`` address has it."""
    try:
        return base64.b64decode(text.rpartition(",")[2], validate=True)
    except (binascii.Error, ValueError):
        raise _wrong("text that is neither base64 nor a path to an image file") from None


def _png_text(mask: U8) -> str:
    return base64.b64encode(cv2.imencode(".png", mask)[1].tobytes()).decode("ascii")


def _wrong(words: str) -> MlflowException:
    """What MLflow's server answers with status 400; the message quotes nothing of the request."""
    return MlflowException.invalid_parameter_value(f"tokt: {words}")
