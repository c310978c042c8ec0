"""The onion detector: its ONNX graph, its weights file, suppression, and that its loss can be learnt.

How well the shipped weights see is measured by the detector's benchmark, not here.
"""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from cell.errors import PerceptionError
from cell.perception.detector import Detector, decode, shipped_weights
from cell.perception.nms import iou, suppress
from cell.perception.onnx_graph import build

torch = pytest.importorskip("torch")
torch.set_num_threads(1)


@cache
def state(seed: int = 3) -> dict[str, np.ndarray]:
    """Weights at random, with batch statistics as after some training."""
    from cell.perception.network import Network

    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    out = {name: value.numpy() for name, value in Network().state_dict().items()}
    for name in out:
        if name.endswith("running_var") or (name.endswith("1.weight") and out[name].ndim == 1):
            out[name] = rng.uniform(0.5, 1.5, out[name].shape).astype(np.float32)
        elif name.endswith(("running_mean", "1.bias")):
            out[name] = rng.normal(0, 0.2, out[name].shape).astype(np.float32)
    return out


@cache
def image(height: int = 96, width: int = 128) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)


# -- the graph --------------------------------------------------------------------------------------


def test_the_onnx_graph_computes_what_the_torch_network_computes() -> None:
    import onnxruntime

    from cell.perception.network import Network, flatten

    network = Network().eval()
    network.load_state_dict({k: torch.from_numpy(np.asarray(v)) for k, v in state().items()})
    session = onnxruntime.InferenceSession(build(state()), providers=["CPUExecutionProvider"])
    for height, width in ((96, 128), (192, 192)):
        x = np.random.default_rng(2).random((1, 3, height, width), dtype=np.float32)
        with torch.no_grad():
            expected = network(torch.from_numpy(x))
        levels = session.run(None, {"image": x})
        for ours, theirs in zip(levels, expected, strict=True):
            np.testing.assert_allclose(ours, theirs.numpy(), atol=1e-4)
        boxes, objects, kinds, _ = flatten(expected)
        for ours, theirs in zip(decode(levels), (boxes, objects.sigmoid(), kinds.sigmoid()), strict=True):
            np.testing.assert_allclose(ours, theirs[0].numpy(), rtol=1e-4, atol=2e-3)


def test_the_graph_names_missing_weights() -> None:
    lacking = {k: v for k, v in state().items() if k != "stem.0.weight"}
    with pytest.raises(KeyError, match=r"stem\.0\.weight"):
        build(lacking)


# -- the weights file ---------------------------------------------------------------------------------


def test_the_shipped_weights_are_small_and_this_networks() -> None:
    from cell.perception.network import Network

    assert shipped_weights().stat().st_size <= 6_000_000
    shipped, network = load_file(shipped_weights()), Network().state_dict()
    needed = {name for name in network if not name.endswith("num_batches_tracked")}
    assert needed <= set(shipped)
    assert all(shipped[name].shape == tuple(network[name].shape) for name in needed)
    assert all(np.isfinite(value).all() for value in shipped.values())


def spoilt(folder: Path) -> list[Path]:
    good = shipped_weights().read_bytes()
    files = {
        "empty": b"",
        "text": b"these are not weights\n",
        "cut": good[:100_000],
        "header": b"\xff" * 8 + good[8:2000],
    }
    paths = []
    for name, data in files.items():
        paths.append(folder / f"{name}.safetensors")
        paths[-1].write_bytes(data)
    lacking = {k: v for k, v in state().items() if not k.startswith("head16")}
    wrong = {**state(), "stem.0.weight": np.zeros((16, 4, 3, 3), np.float32)}
    for name, values in (("lacking", lacking), ("shape", wrong)):
        paths.append(folder / f"{name}.safetensors")
        save_file({k: np.ascontiguousarray(v) for k, v in values.items()}, paths[-1])
    return [*paths, folder]


def test_missing_or_corrupt_weights_are_one_sentence_with_advice(tmp_path: Path) -> None:
    for path in [tmp_path / "none.safetensors", *spoilt(tmp_path)]:
        with pytest.raises(PerceptionError) as caught:
            Detector(path)
        said = str(caught.value)
        assert str(path) in said and "tools/train_detector" in said and "\n" not in said, said


# -- what comes out -------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(480, 640), (192, 192), (97, 131), (32, 32)])
def test_any_image_size_gives_boxes_inside_the_image(size: tuple[int, int]) -> None:
    height, width = size
    found = Detector().detect(image(height, width))
    scores = [box.score for box, _ in found]
    assert scores == sorted(scores, reverse=True)
    for box, p in found:
        x0, y0, x1, y1 = box.box
        assert 0 <= x0 <= x1 <= width - 1 and 0 <= y0 <= y1 <= height - 1
        assert 0 <= p <= 1 and 0 < box.score <= 1
        assert box.label == ("blemished" if p >= 0.5 else "unblemished")


SCRIPT = """
import sys
from pathlib import Path
from cell.perception.detector import Detector
from tests.test_detector import image
detector = Detector(Path(sys.argv[1]))
x = image().transpose(2, 0, 1)[None].astype("float32") / 255
print(detector._session.run(None, {"image": x})[0].tobytes().hex())
"""


def test_two_processes_compute_the_same_bits(tmp_path: Path) -> None:
    file = tmp_path / "random.safetensors"
    save_file({k: np.ascontiguousarray(v) for k, v in state().items()}, file)
    runs = [
        subprocess.Popen([sys.executable, "-c", SCRIPT, str(file)], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    first, second = (run.communicate(timeout=60)[0] for run in runs)
    assert len(first) > 1000 and first == second


# -- suppression ----------------------------------------------------------------------------------------


def test_overlap() -> None:
    a = np.array([0, 0, 10, 10], np.float32)
    others = np.array([[0, 0, 10, 10], [5, 0, 15, 10], [10, 0, 20, 10], [30, 30, 40, 40]], np.float32)
    np.testing.assert_allclose(iou(a, others), [1.0, 1 / 3, 0.0, 0.0], atol=1e-6)


def test_of_overlapping_boxes_the_most_certain_stays() -> None:
    boxes = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [30, 0, 40, 10], [31, 1, 41, 11]], np.float32)
    assert suppress(boxes, np.array([0.8, 0.9, 0.3, 0.2], np.float32)) == [1, 2]
    assert suppress(np.zeros((0, 4), np.float32), np.zeros(0, np.float32)) == []


def test_neighbours_that_touch_both_stay_and_a_chain_is_not_swallowed() -> None:
    """B overlaps A and C, but A and C do not overlap: removing B must not remove C."""
    boxes = np.array([[0, 0, 10, 10], [3, 0, 13, 10], [7, 0, 17, 10]], np.float32)
    assert suppress(boxes, np.array([0.9, 0.8, 0.7], np.float32), threshold=0.5) == [0, 2]


# -- learning -------------------------------------------------------------------------------------------


def test_the_loss_falls_when_one_image_is_learnt() -> None:
    from cell.perception.loss import detector_loss
    from cell.perception.network import Network

    torch.manual_seed(1)
    network = Network().train()
    picture = torch.full((1, 3, 96, 96), 0.2)
    picture[0, :, 20:60, 30:70] = 0.8
    picture[0, 0, 64:90, 10:36] = 0.9
    target = torch.tensor([[30.0, 20.0, 69.0, 59.0, 0.0], [10.0, 64.0, 35.0, 89.0, 1.0]])
    optimizer = torch.optim.AdamW(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(40):
        loss = detector_loss(network(picture), [target])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert np.isfinite(losses).all()
    assert np.mean(losses[-5:]) < 0.35 * losses[0]


def test_an_image_without_onions_teaches_only_silence() -> None:
    from cell.perception.loss import detector_loss
    from cell.perception.network import Network

    torch.manual_seed(1)
    network = Network().eval()
    loss = detector_loss(network(torch.rand(1, 3, 64, 64)), [torch.zeros((0, 5))])
    loss.backward()
    assert torch.isfinite(loss)
    kinds = network.head8.kind_out.weight.grad
    assert kinds is None or float(kinds.abs().max()) == 0.0
