"""The onion detector's network, in torch; used for training and as reference for the ONNX graph.

One stage, anchor-free: a small CSP backbone, a two-level top-down and bottom-up neck, and a
decoupled head on strides 8 and 16. Each cell predicts the distances from its centre to the
four sides of a box, an objectness, and one logit per class.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

CLASSES = ("blemished", "unblemished")
STRIDES = (8, 16)


class Conv(nn.Sequential):
    """Convolution, batch normalisation, SiLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 1, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.SiLU(inplace=True),
        )


class Residual(nn.Module):
    """1x1 then 3x3, added to its input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.a, self.b = Conv(width, width, 1), Conv(width, width, 3)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x + self.b(self.a(x))
        return out


class Csp(nn.Module):
    """Cross-stage partial block: half of the channels go through `depth` residuals."""

    def __init__(self, inputs: int, outputs: int, depth: int) -> None:
        super().__init__()
        half = outputs // 2
        self.deep, self.flat = Conv(inputs, half), Conv(inputs, half)
        self.blocks = nn.Sequential(*(Residual(half) for _ in range(depth)))
        self.join = Conv(2 * half, outputs)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.join(torch.cat([self.blocks(self.deep(x)), self.flat(x)], dim=1))
        return out


class Head(nn.Module):
    """Box distances and objectness from one branch, classes from the other."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.stem = Conv(inputs, 64)
        self.box, self.box_out = Conv(64, 64, 3), nn.Conv2d(64, 5, 1)
        self.kind, self.kind_out = Conv(64, 64, 3), nn.Conv2d(64, len(CLASSES), 1)
        nn.init.constant_(self.box_out.bias[:4], 0.5)  # type: ignore[index]
        nn.init.constant_(self.box_out.bias[4:], -4.0)  # type: ignore[index]

    def forward(self, x: Tensor) -> Tensor:
        x = self.stem(x)
        return torch.cat([self.box_out(self.box(x)), self.kind_out(self.kind(x))], dim=1)


class Network(nn.Module):
    """Images (B, 3, H, W) in 0..1, H and W multiples of 32 -> one (B, 7, H/s, W/s) per stride s.

    The 7 channels: left, top, right, bottom (raw), objectness logit, one logit per class.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stem = Conv(3, 16, 3, 2)
        self.stage1 = nn.Sequential(Conv(16, 32, 3, 2), Csp(32, 32, 1))
        self.stage2 = nn.Sequential(Conv(32, 64, 3, 2), Csp(64, 64, 2))
        self.stage3 = nn.Sequential(Conv(64, 128, 3, 2), Csp(128, 128, 2))
        self.stage4 = nn.Sequential(Conv(128, 192, 3, 2), Csp(192, 192, 1))
        self.reduce4, self.merge3 = Conv(192, 128), Csp(256, 128, 1)
        self.reduce3, self.merge2 = Conv(128, 64), Csp(128, 64, 1)
        self.down2, self.merge_up = Conv(64, 64, 3, 2), Csp(192, 128, 1)
        self.head8, self.head16 = Head(64), Head(128)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        f2 = self.stage2(self.stage1(self.stem(x)))
        f3 = self.stage3(f2)
        p3 = self.merge3(torch.cat([_double(self.reduce4(self.stage4(f3))), f3], dim=1))
        p2 = self.merge2(torch.cat([_double(self.reduce3(p3)), f2], dim=1))
        n3 = self.merge_up(torch.cat([self.down2(p2), p3], dim=1))
        return self.head8(p2), self.head16(n3)


def flatten(levels: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Network outputs as lists of cells.

    Returns:
        boxes (B, A, 4) x0, y0, x1, y1 [px]; objectness logits (B, A); class logits (B, A, 2);
        cells (A, 3): centre x, y and stride [px]. Pixel (0, 0) is the centre of the first pixel.
    """
    boxes, objects, kinds, cells = [], [], [], []
    for level, stride in zip(levels, STRIDES, strict=True):
        batch, _, height, width = level.shape
        y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        centre = torch.stack([x, y], dim=-1).reshape(-1, 2).float() * stride + (stride - 1) / 2
        flat = level.reshape(batch, 7, -1).transpose(1, 2)
        sides = nn.functional.softplus(flat[..., :4]) * (2.0 * stride)
        boxes.append(torch.cat([centre - sides[..., :2], centre + sides[..., 2:]], dim=-1))
        objects.append(flat[..., 4])
        kinds.append(flat[..., 5:])
        cells.append(torch.cat([centre, torch.full((len(centre), 1), float(stride))], dim=1))
    return torch.cat(boxes, 1), torch.cat(objects, 1), torch.cat(kinds, 1), torch.cat(cells)


def _double(x: Tensor) -> Tensor:
    return nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")
