"""The hand networks' files: where they are, that they are the right ones, and running them.

The networks are the palm detector and the hand-landmark model of MediaPipe (Apache-2.0). They
are not part of this package: `cell.perception.hands.fetch` takes them from the wheel
`mediapipe==0.10.21` into a cache directory. Every file is checked by SHA-256 before it is used.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.errors import PerceptionError

GET_MODELS = "python -m cell.perception.hands.fetch"
"""The command that puts the files in place."""

Tensor = NDArray[np.float32]


class HandModelError(PerceptionError):
    """A hand network's file is missing, altered or cannot be run."""


@dataclass(frozen=True)
class ModelFile:
    """One network's file.

    Attributes:
        name: of the file. member: its path inside the wheel. size: [bytes]. sha256: hexadecimal.
    """

    name: str
    member: str
    size: int
    sha256: str


PALM = ModelFile(
    "palm_detection_full.tflite",
    "mediapipe/modules/palm_detection/palm_detection_full.tflite",
    2_339_846,
    "1b14e9422c6ad006cde6581a46c8b90dd573c07ab7f3934b5589e7cea3f89a54",
)
LANDMARK = ModelFile(
    "hand_landmark_full.tflite",
    "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
    5_478_917,
    "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
)
MODELS = (PALM, LANDMARK)


def cache_dir() -> Path:
    """Where the files are kept: XDG_CACHE_HOME (or ~/.cache)/sorting-cell/hands."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "sorting-cell" / "hands"


def read_model(model: ModelFile, folder: Path | None = None) -> bytes:
    """A network's file, checked.

    Args:
        model: `PALM` or `LANDMARK`.
        folder: directory of the file; the cache if None.

    Raises:
        HandModelError: the file is missing or is not the expected one.
    """
    path = (folder or cache_dir()) / model.name
    into = f" --into {folder}" if folder else ""
    remedy = f"run: {GET_MODELS}{into} (or set 'gestures: models:' to the folder that has it)"
    try:
        with path.open("rb") as file:
            data = file.read(model.size + 1)
    except OSError as error:
        raise HandModelError(f"hand network {path} is missing ({error.strerror}); {remedy}") from None
    problem = mismatch(model, data)
    if problem:
        raise HandModelError(f"hand network {path}: {problem}; {remedy}")
    return data


def mismatch(model: ModelFile, data: bytes) -> str:
    """Why `data` is not the network `model`; empty when it is."""
    if len(data) != model.size:
        return f"expected {model.size} bytes, got {'more' if len(data) > model.size else len(data)}"
    digest = hashlib.sha256(data).hexdigest()
    return "" if digest == model.sha256 else f"expected SHA-256 {model.sha256}, got {digest}"


class Network:
    """One .tflite network on the CPU.

    Args:
        data: the file's content.
        side: of the square input image [px].
        outputs: expected shapes of the outputs, in order.
        threads: CPU threads of one inference.

    Raises:
        HandModelError: `ai-edge-litert` is missing, or the network is not the expected one.
    """

    def __init__(
        self, data: bytes, side: int, outputs: tuple[tuple[int, ...], ...], threads: int = 1
    ) -> None:
        try:
            from ai_edge_litert.interpreter import Interpreter
        except ImportError:
            raise HandModelError("the hand networks need: pip install ai-edge-litert") from None
        try:
            with _silent():
                self._interpreter: Any = Interpreter(model_content=data, num_threads=threads)
                self._interpreter.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise HandModelError(f"the hand network cannot be run: {reason}") from None
        inputs, found = self._interpreter.get_input_details(), self._interpreter.get_output_details()
        shapes = tuple(tuple(int(n) for n in d["shape"]) for d in (*inputs, *found))
        wanted = ((1, side, side, 3), *outputs)
        if shapes != wanted:
            raise HandModelError(f"the hand network has tensors {shapes}; expected {wanted}")
        self._input: int = inputs[0]["index"]
        self._outputs: tuple[int, ...] = tuple(d["index"] for d in found)

    def run(self, image: NDArray[np.uint8]) -> tuple[Tensor, ...]:
        """The outputs for an image (side, side, 3) uint8 RGB, which is scaled to 0..1."""
        tensor = image.astype(np.float32) * np.float32(1 / 255)
        self._interpreter.set_tensor(self._input, tensor[None])
        self._interpreter.invoke()
        return tuple(np.asarray(self._interpreter.get_tensor(i), np.float32) for i in self._outputs)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep what the library writes to standard error by itself away from users."""
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)
