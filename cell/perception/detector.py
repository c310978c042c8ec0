"""Finds onions in images: the trained network on onnxruntime, decoded and suppressed in numpy."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.errors import PerceptionError
from cell.perception.nms import suppress
from cell.wire.types import Box

STRIDES = (8, 16)
_FLOOR = 0.05
"""Detections less likely than this are not even reported."""
_RETRAIN = "train it with tools/train_detector, or set 'detector:' to a .safetensors file"


def shipped_weights() -> Path:
    """Path of the weights in the package."""
    return Path(str(files("cell.perception") / "weights" / "detector.safetensors"))


class Detector:
    """The onion detector.

    Args:
        weights: .safetensors file of `cell.perception.network.Network`; the shipped one if None.
        threads: CPU threads of one inference.

    Raises:
        PerceptionError: the weights are missing or are not this network's.
    """

    def __init__(self, weights: Path | None = None, threads: int = 1) -> None:
        import onnxruntime
        from safetensors import SafetensorError
        from safetensors.numpy import load_file

        from cell.perception.onnx_graph import build

        path = weights or shipped_weights()
        if not path.is_file():
            raise PerceptionError(f"detector weights {path} are missing; {_RETRAIN}")
        try:
            state = {name: np.asarray(value, np.float32) for name, value in load_file(path).items()}
            model = build(state)
        except (SafetensorError, OSError, ValueError) as error:
            raise PerceptionError(f"detector weights {path} cannot be read ({error}); {_RETRAIN}") from None
        except KeyError as error:
            raise PerceptionError(f"detector weights {path} lack {error}; {_RETRAIN}") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
            levels = self._session.run(None, {"image": np.zeros((1, 3, 64, 64), np.float32)})
        except Exception as error:  # onnxruntime's errors share no narrower base
            reason = " ".join(str(error).split())[:200]
            raise PerceptionError(f"detector weights {path} do not fit ({reason}); {_RETRAIN}") from None
        shapes = [level.shape for level in levels]
        if shapes != [(1, 7, 64 // s, 64 // s) for s in STRIDES] or not all(
            np.isfinite(v).all() for v in levels
        ):
            raise PerceptionError(f"detector weights {path} are not this network's; {_RETRAIN}")

    def detect(self, rgb: NDArray[np.uint8]) -> tuple[tuple[Box, float], ...]:
        """Onions in an image, the most certain first.

        Args:
            rgb: shape (H, W, 3) uint8, any size.

        Returns:
            (box, P(blemished)) each; the box carries the likelier class and its score.
        """
        height, width = rgb.shape[:2]
        padded = np.full((-(-height // 32) * 32, -(-width // 32) * 32, 3), 114, np.uint8)
        padded[:height, :width] = rgb
        image = padded.transpose(2, 0, 1)[None].astype(np.float32) / np.float32(255.0)
        boxes, objects, kinds = decode(self._session.run(None, {"image": image}))
        score = objects * kinds.max(axis=1)
        keep = score > _FLOOR
        boxes, score, kinds = boxes[keep], score[keep], kinds[keep]
        limit = np.array([width - 1, height - 1, width - 1, height - 1], np.float32)
        found = []
        for i in suppress(boxes, score):
            x0, y0, x1, y1 = (float(v) for v in np.clip(boxes[i], 0, limit))
            p = float(kinds[i, 0] / (kinds[i, 0] + kinds[i, 1] + 1e-9))
            label = "blemished" if p >= 0.5 else "unblemished"
            found.append((Box((x0, y0, x1, y1), label, float(score[i])), p))
        return tuple(found)


def decode(
    levels: list[NDArray[np.float32]],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Network outputs -> boxes (A, 4) [px], objectness (A,), class probabilities (A, 2)."""
    boxes, objects, kinds = [], [], []
    for level, stride in zip(levels, STRIDES, strict=True):
        _, channels, height, width = level.shape
        flat = level.reshape(channels, -1).T
        y, x = np.divmod(np.arange(height * width), width)
        centre = np.stack([x, y], axis=1).astype(np.float32) * stride + np.float32((stride - 1) / 2)
        sides = np.logaddexp(np.float32(0), flat[:, :4]) * np.float32(2 * stride)
        boxes.append(np.concatenate([centre - sides[:, :2], centre + sides[:, 2:]], axis=1))
        logits = 1 / (1 + np.exp(-flat[:, 4:]))
        objects.append(logits[:, 0])
        kinds.append(logits[:, 1:])
    return np.concatenate(boxes), np.concatenate(objects), np.concatenate(kinds)
