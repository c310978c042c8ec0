"""Training loss of the detector: which cells answer for which onion, and how wrong they are.

Assignment follows the idea of SimOTA: among the cells in the middle of a box, the few with the
least cost (class, objectness and overlap) are made responsible, as many as the box deserves.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy, binary_cross_entropy_with_logits

from cell.perception.network import flatten

_CENTRE = 1.5
"""Cells within this many strides of a box's centre may answer for it."""
_MOST = 8
_BOX_WEIGHT, _KIND_WEIGHT = 5.0, 2.0


def detector_loss(levels: tuple[Tensor, Tensor], targets: list[Tensor]) -> Tensor:
    """Mean loss of a batch.

    Args:
        levels: network outputs.
        targets: per image (G, 5): box x0, y0, x1, y1 [px] and P(blemished).
    """
    boxes, objects, kinds, cells = flatten(levels)
    box_loss = kind_loss = torch.zeros(())
    wanted = torch.zeros_like(objects)
    positives = 0
    for i, target in enumerate(targets):
        if not len(target):
            continue
        cell, truth = _assign(boxes[i].detach(), objects[i].detach(), kinds[i].detach(), cells, target)
        if not len(cell):
            continue
        wanted[i, cell] = 1.0
        positives += len(cell)
        box_loss = box_loss + (1.0 - giou(boxes[i, cell], target[truth, :4])).sum()
        blemished = target[truth, 4]
        soft = torch.stack([blemished, 1.0 - blemished], dim=1)
        kind_loss = kind_loss + binary_cross_entropy_with_logits(kinds[i, cell], soft, reduction="sum")
    object_loss = binary_cross_entropy_with_logits(objects, wanted, reduction="sum")
    return (_BOX_WEIGHT * box_loss + _KIND_WEIGHT * kind_loss + object_loss) / max(positives, 1)


def iou_matrix(a: Tensor, b: Tensor) -> Tensor:
    """Overlap of every box of a (A, 4) with every box of b (B, 4), shape (A, B)."""
    low, high = torch.maximum(a[:, None, :2], b[None, :, :2]), torch.minimum(a[:, None, 2:], b[None, :, 2:])
    inner = (high - low).clamp(min=0).prod(dim=2)
    area_a, area_b = (a[:, 2:] - a[:, :2]).prod(dim=1), (b[:, 2:] - b[:, :2]).prod(dim=1)
    return inner / (area_a[:, None] + area_b[None, :] - inner + 1e-9)


def giou(a: Tensor, b: Tensor) -> Tensor:
    """Generalised overlap of paired boxes (N, 4), shape (N,)."""
    low, high = torch.maximum(a[:, :2], b[:, :2]), torch.minimum(a[:, 2:], b[:, 2:])
    inner = (high - low).clamp(min=0).prod(dim=1)
    union = (a[:, 2:] - a[:, :2]).prod(dim=1) + (b[:, 2:] - b[:, :2]).prod(dim=1) - inner
    hull = (torch.maximum(a[:, 2:], b[:, 2:]) - torch.minimum(a[:, :2], b[:, :2])).prod(dim=1)
    return inner / (union + 1e-9) - (hull - union) / (hull + 1e-9)


@torch.no_grad()
def _assign(
    boxes: Tensor, objects: Tensor, kinds: Tensor, cells: Tensor, target: Tensor
) -> tuple[Tensor, Tensor]:
    """Indices of responsible cells (P,) and the target each answers for (P,)."""
    centre = (target[:, :2] + target[:, 2:4]) / 2
    x, y, stride = cells[:, 0:1], cells[:, 1:2], cells[:, 2:3]
    inside = (x > target[:, 0]) & (x < target[:, 2]) & (y > target[:, 1]) & (y < target[:, 3])
    near = ((x - centre[:, 0]).abs() < _CENTRE * stride) & ((y - centre[:, 1]).abs() < _CENTRE * stride)
    candidates = torch.nonzero((inside & near).any(dim=1)).squeeze(1)
    if not len(candidates):
        return candidates, candidates
    allowed = (inside & near)[candidates]
    overlap = iou_matrix(boxes[candidates], target[:, :4])
    chance = (objects[candidates, None].sigmoid() * kinds[candidates].sigmoid()).sqrt()
    soft = torch.stack([target[:, 4], 1.0 - target[:, 4]], dim=1)
    kind_cost = binary_cross_entropy(
        chance[:, None, :].expand(-1, len(target), -1),
        soft[None].expand(len(candidates), -1, -1),
        reduction="none",
    ).sum(dim=2)
    cost = kind_cost - 3.0 * torch.log(overlap + 1e-8) + 1e5 * (~allowed)
    owner = torch.full((len(candidates),), -1)
    best = torch.full((len(candidates),), torch.inf)
    for g in range(len(target)):
        count = int(
            overlap[allowed[:, g], g].topk(min(_MOST, int(allowed[:, g].sum()))).values.sum().clamp(1, _MOST)
        )
        picked = cost[:, g].topk(min(count, len(candidates)), largest=False).indices
        picked = picked[allowed[picked, g] & (cost[picked, g] < best[picked])]
        owner[picked], best[picked] = g, cost[picked, g]
    chosen = torch.nonzero(owner >= 0).squeeze(1)
    return candidates[chosen], owner[chosen]
