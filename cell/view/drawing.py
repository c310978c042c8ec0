"""The cameras' pictures with what was found in them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.view.moment import Moment
from cell.wire.types import Detections, Hands

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

LABELS: dict[str, Colour] = {"blemished": (235, 70, 60), "unblemished": (70, 190, 90)}
"""Colours of what is believed of an onion."""
OTHER: Colour = (230, 180, 60)
_SIGNS = {"up": (70, 190, 90), "down": (235, 70, 60)}
_HAND = (255, 210, 70)
_BONES = (
    (0, 1, 2, 3, 4), (0, 5, 6, 7, 8), (5, 9, 10, 11, 12), (9, 13, 14, 15, 16), (13, 17, 18, 19, 20), (0, 17),
)  # fmt: skip
"""Chains of MediaPipe's 21 landmarks."""
_WIDTH, _HEIGHT = 320, 240


def both(moment: Moment) -> Picture | None:
    """Belt camera and person camera side by side, (240, 644, 3); None before the first picture."""
    pictures = []
    belt = moment.frames.get("belt")
    if moment.detections is not None:
        pictures.append(_with_boxes(moment.detections[1].rgb, moment.detections[0]))
    elif belt is not None:
        pictures.append(_small(belt.rgb)[0])
    person = moment.frames.get("person")
    if moment.hands is not None:
        pictures.append(_with_hands(moment.hands[1].rgb, moment.hands[0]))
    elif person is not None:
        pictures.append(_small(person.rgb)[0])
    if not pictures:
        return None
    while len(pictures) < 2:
        pictures.append(np.full((_HEIGHT, _WIDTH, 3), 60, np.uint8))
    gap = np.full((_HEIGHT, 4, 3), 255, np.uint8)
    return np.concatenate([pictures[0], gap, pictures[1]], axis=1)


def _with_boxes(rgb: Picture, detections: Detections) -> Picture:
    picture, scale = _small(rgb)
    for box in detections.boxes:
        x0, y0, x1, y1 = (round(v * scale) for v in box.box)
        cv2.rectangle(picture, (x0, y0), (x1, y1), LABELS.get(box.label, OTHER), 2, cv2.LINE_AA)
    return picture


def _with_hands(rgb: Picture, hands: Hands) -> Picture:
    picture, scale = _small(rgb)
    for hand in hands.hands:
        points = np.round(hand.landmarks * scale).clip(-2000, 2000).astype(np.int32)
        colour = _SIGNS.get(hand.gesture, _HAND)
        for chain in _BONES:
            cv2.polylines(picture, [points[list(chain)]], False, colour, 2, cv2.LINE_AA)
        if hand.gesture:
            where = (int(points[:, 0].min()), max(int(points[:, 1].min()) - 6, 14))
            text = f"thumb {hand.gesture}"
            cv2.putText(picture, text, where, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 2, cv2.LINE_AA)
    return picture


def _small(rgb: Picture) -> tuple[Picture, float]:
    """The picture within _WIDTH x _HEIGHT on grey, and the scale of pixels."""
    height, width = rgb.shape[:2]
    scale = min(_WIDTH / width, _HEIGHT / height)
    size = (round(width * scale), round(height * scale))
    out = np.full((_HEIGHT, _WIDTH, 3), 60, np.uint8)
    out[: size[1], : size[0]] = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    return out, scale
