"""Builds the detector's ONNX graph straight from its weights, so that running it needs no torch.

Mirrors `cell.perception.network`; batch normalisation is folded into the convolutions. A test
holds the two to each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

Weights = Mapping[str, NDArray[np.float32]]
_EPS = 1e-5
_OPSET = 13


def build(weights: Weights) -> bytes:
    """A serialised ONNX model: `image` (1, 3, H, W) 0..1 -> `level8`, `level16`.

    Args:
        weights: the state of `Network` by name. Raises KeyError naming what is missing.
    """
    g = _Graph(weights)
    x = g.stage("stage2", g.stage("stage1", g.conv("stem", "image", 2), 1), 2)
    f2, f3 = x, g.stage("stage3", x, 2)
    f4 = g.stage("stage4", f3, 1)
    p3 = g.csp("merge3", g.concat(g.double(g.conv("reduce4", f4)), f3), 1)
    p2 = g.csp("merge2", g.concat(g.double(g.conv("reduce3", p3)), f2), 1)
    n3 = g.csp("merge_up", g.concat(g.conv("down2", p2, 2), p3), 1)
    g.head("head8", p2, "level8")
    g.head("head16", n3, "level16")
    shape: list[str | int | None] = [1, 3, "height", "width"]
    graph = helper.make_graph(
        g.nodes,
        "onion_detector",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 7, f"{name}_h", f"{name}_w"])
            for name in ("level8", "level16")
        ],
        g.constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)])
    model.ir_version = 8
    onnx.checker.check_model(model)
    out: bytes = model.SerializeToString()
    return out


class _Graph:
    """Nodes and constants under construction; methods return the name of their output."""

    def __init__(self, weights: Weights) -> None:
        self._weights = weights
        self.nodes: list[Any] = []
        self.constants: list[Any] = [
            numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "twice"),
        ]

    def conv(self, name: str, x: str, stride: int = 1) -> str:
        """Convolution with folded batch normalisation, then SiLU."""
        w = self._weights
        scale = w[f"{name}.1.weight"] / np.sqrt(w[f"{name}.1.running_var"] + _EPS)
        kernel = w[f"{name}.0.weight"] * scale[:, None, None, None]
        bias = w[f"{name}.1.bias"] - w[f"{name}.1.running_mean"] * scale
        y = self._convolve(name, x, kernel, bias, stride)
        gate = self._node("Sigmoid", [y], f"{name}.gate")
        return self._node("Mul", [y, gate], f"{name}.silu")

    def stage(self, name: str, x: str, depth: int) -> str:
        return self.csp(f"{name}.1", self.conv(f"{name}.0", x, 2), depth)

    def csp(self, name: str, x: str, depth: int) -> str:
        y = self.conv(f"{name}.deep", x)
        for i in range(depth):
            z = self.conv(f"{name}.blocks.{i}.b", self.conv(f"{name}.blocks.{i}.a", y))
            y = self._node("Add", [y, z], f"{name}.blocks.{i}.sum")
        return self.conv(f"{name}.join", self.concat(y, self.conv(f"{name}.flat", x)))

    def head(self, name: str, x: str, output: str) -> None:
        x = self.conv(f"{name}.stem", x)
        parts = []
        for branch in ("box", "kind"):
            y = self.conv(f"{name}.{branch}", x)
            out = f"{name}.{branch}_out"
            parts.append(
                self._convolve(out, y, self._weights[f"{out}.weight"], self._weights[f"{out}.bias"], 1)
            )
        self.nodes.append(helper.make_node("Concat", parts, [output], axis=1))

    def concat(self, a: str, b: str) -> str:
        return self._node("Concat", [a, b], f"{a}|{b}", axis=1)

    def double(self, x: str) -> str:
        return self._node(
            "Resize",
            [x, "", "twice"],
            f"{x}.double",
            mode="nearest",
            coordinate_transformation_mode="asymmetric",
            nearest_mode="floor",
        )

    def _convolve(
        self, name: str, x: str, kernel: NDArray[np.float32], bias: NDArray[np.float32], stride: int
    ) -> str:
        for suffix, value in (("kernel", kernel), ("bias", bias)):
            self.constants.append(
                numpy_helper.from_array(np.ascontiguousarray(value, np.float32), f"{name}.{suffix}")
            )
        pad = kernel.shape[2] // 2
        return self._node(
            "Conv",
            [x, f"{name}.kernel", f"{name}.bias"],
            f"{name}.conv",
            strides=[stride] * 2,
            pads=[pad] * 4,
        )

    def _node(self, kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output
