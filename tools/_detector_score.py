"""How good a detector is on labelled samples: average precision, recall, place in the world."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from _detector_data import BLEMISH_PIXELS, Sample

from cell.config import CellConfig
from cell.frames import Pinhole, look_at
from cell.perception.localise import locate
from cell.perception.nms import iou
from cell.wire.types import Box

Detect = Callable[[Any], tuple[tuple[Box, float], ...]]
CLASSES = ("blemished", "unblemished")
CLEAR = 0.5
"""Share of an onion that must be visible for the recall; the rest are slivers behind arm and bin."""


def score(detect: Detect, samples: list[Sample], config: CellConfig) -> dict[str, Any]:
    """mAP50 over both classes, AP50 each, recall of onions, 3-D centre error on the belt."""
    camera = config.cameras["belt"]
    pinhole = Pinhole.from_hfov(camera.width, camera.height, camera.hfov)
    X_WC = look_at(camera.position, camera.target)
    ranked: dict[str, list[tuple[float, bool]]] = {name: [] for name in CLASSES}
    truths = dict.fromkeys(CLASSES, 0)
    onions = found = extra = right = clear = clear_found = 0
    errors: list[float] = []
    unlocated = 0
    for sample in samples:
        detections = detect(sample.rgb)
        kinds = ["blemished" if n >= BLEMISH_PIXELS else "unblemished" for n in sample.blemish]
        for name in CLASSES:
            truths[name] += kinds.count(name)
            of_kind = [i for i, kind in enumerate(kinds) if kind == name]
            # Each class is ranked by its own probability, so a near miss in class still counts low.
            scored = [(_class_score(box, p, name), box) for box, p in detections]
            ranked[name] += _match(scored, sample.boxes[of_kind])
        confident = [(box, p) for box, p in detections if box.score >= config.supervisor.score_threshold]
        taken: set[int] = set()
        for box, _ in confident:
            overlaps = iou(np.array(box.box, np.float32), sample.boxes) if len(sample.boxes) else np.zeros(0)
            best = int(overlaps.argmax()) if len(overlaps) else -1
            if best < 0 or overlaps[best] < 0.5 or best in taken:
                extra += 1
                continue
            taken.add(best)
            right += box.label == kinds[best]
            if sample.on_belt[best] and not sample.held[best]:
                located = locate(box, sample.depth, pinhole, X_WC)
                if located is None:
                    unlocated += 1
                else:
                    errors.append(float(np.linalg.norm(located.p_WO - sample.p_WO[best])))
        onions += len(sample.boxes)
        found += len(taken)
        seen_well = {i for i, share in enumerate(sample.visible) if share >= CLEAR}
        clear += len(seen_well)
        clear_found += len(seen_well & taken)
    precision = {name: _average_precision(ranked[name], truths[name]) for name in CLASSES}
    return {
        "images": len(samples),
        "onions": onions,
        "mAP50": float(np.mean(list(precision.values()))),
        "AP50": precision,
        "recall": clear_found / max(clear, 1),
        "recall_of": f"{clear} onions of which at least {CLEAR:.0%} is visible",
        "recall_with_slivers": found / max(onions, 1),
        "extra_boxes": extra,
        "class_right": right / max(found, 1),
        "centre_error_mm": {
            "median": float(np.median(errors) * 1e3) if errors else None,
            "p95": float(np.percentile(errors, 95) * 1e3) if errors else None,
            "max": float(np.max(errors) * 1e3) if errors else None,
            "boxes": len(errors),
            "boxes_without_place": unlocated,
        },
    }


def _class_score(box: Box, p_blemished: float, name: str) -> float:
    top = max(p_blemished, 1 - p_blemished)
    return box.score * (p_blemished if name == "blemished" else 1 - p_blemished) / top


def _match(scored: list[tuple[float, Box]], truth: Any) -> list[tuple[float, bool]]:
    """(score, hit) of each detection against boxes of one class, the best first taking its box."""
    free = np.ones(len(truth), bool)
    out = []
    for value, box in sorted(scored, key=lambda item: -item[0]):
        overlaps = np.where(free, iou(np.array(box.box, np.float32), truth), 0) if len(truth) else np.zeros(0)
        best = int(overlaps.argmax()) if len(overlaps) else -1
        hit = best >= 0 and bool(overlaps[best] >= 0.5)
        if hit:
            free[best] = False
        out.append((value, hit))
    return out


def _average_precision(ranked: list[tuple[float, bool]], truths: int) -> float:
    """Area under the precision-recall curve with precision made monotone (all points)."""
    if not ranked or not truths:
        return 0.0
    ranked = sorted(ranked, key=lambda item: -item[0])
    hits = np.cumsum([hit for _, hit in ranked])
    precision = hits / np.arange(1, len(ranked) + 1)
    recall = hits / truths
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(np.diff(np.concatenate([[0.0], recall])) * precision))
