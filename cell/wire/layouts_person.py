"""How `cell_msgs` carry what is seen of the person, and the simulation's ground truth."""

from __future__ import annotations

from typing import Any

import numpy as np

from cell.errors import DecodeError, WireError, one_of
from cell.wire import cdr
from cell.wire.layouts import Simple, camera_of, header, optical_frame
from cell.wire.types import Hands, PersonTruth, SeenHand, ShownGesture, Truth
from cell.wire.typestore import POINT, make

#: Most onions in a round, hands in a frame, signs in a round.
MAX_ONIONS = 1000
MAX_HANDS = 8
MAX_SIGNS = 1000

_SIDES = ("", "left", "right")
_GESTURES = ("", "up", "down")


def _point(p: Any) -> Any:
    return make(POINT)(*map(float, p))


def _xyz(p: Any, name: str) -> tuple[float, float, float]:
    return cdr.finite(p.x, name), cdr.finite(p.y, name), cdr.finite(p.z, name)


def _word(value: str, legal: tuple[str, ...], name: str) -> str:
    if value not in legal:
        raise DecodeError(f"{name}: {one_of(cdr.text(value, name), legal)}")
    return value


class HandsLayout(Simple[Hands]):
    ros_type = "cell_msgs/msg/Hands"

    def to_ros(self, m: Hands) -> Any:
        if len(m.hands) > MAX_HANDS:
            raise WireError(f"{len(m.hands)} hands, at most {MAX_HANDS} can be sent")
        return make(self.ros_type)(header(m.t, optical_frame(m.camera)), [self._hand(h) for h in m.hands])

    def _hand(self, h: SeenHand) -> Any:
        if h.landmarks.shape != (21, 2):
            raise WireError(f"landmarks must have shape (21, 2), got {h.landmarks.shape}")
        flat = np.ascontiguousarray(h.landmarks, dtype=np.float64).ravel()
        return make("cell_msgs/msg/SeenHand")(h.side, h.presence, h.gesture, _point(h.p_WH), flat)

    def from_ros(self, ros: Any) -> Hands:
        if len(ros.hands) > MAX_HANDS:
            raise DecodeError(f"{len(ros.hands)} hands, at most {MAX_HANDS} are allowed")
        hands = tuple(
            SeenHand(
                _word(h.side, _SIDES, "side"),
                cdr.finite(h.presence, "presence"),
                _word(h.gesture, _GESTURES, "gesture"),
                _xyz(h.position, "position"),
                cdr.vector(h.landmarks, 42, "landmarks").reshape(21, 2),
            )
            for h in ros.hands
        )
        return Hands(cdr.seconds(ros.header.stamp, "stamp"), camera_of(ros.header.frame_id), hands)


class TruthLayout(Simple[Truth]):
    ros_type = "cell_msgs/msg/Truth"
    limit = 8 * 1024 * 1024

    def to_ros(self, m: Truth) -> Any:
        n = len(m.place)
        fits = m.blemished.shape == m.radius.shape == (n,) and m.p_WO.shape == (n, 3)
        if not (fits and m.by_human.shape in ((n,), (0,)) and n <= MAX_ONIONS):
            raise WireError(f"truth: lists of {n} onions differ in length or exceed {MAX_ONIONS}")
        return make(self.ros_type)(
            cdr.stamp(m.t),
            m.blemished.astype(np.bool_),
            list(m.place),
            [_point(p) for p in m.p_WO],
            np.ascontiguousarray(m.radius, dtype=np.float64),
            m.arm_contacts,
            list(m.contact_log),
            m.by_human.astype(np.bool_),
            [] if m.person is None else [self._person(m.person)],
        )

    def _person(self, p: PersonTruth) -> Any:
        if p.p_WH.shape != (2, 3) or len(p.gestures) > MAX_SIGNS:
            raise WireError(f"person: needs two hands and at most {MAX_SIGNS} signs")
        shown = make("cell_msgs/msg/ShownGesture")
        return make("cell_msgs/msg/PersonTruth")(
            p.name,
            p.fatigued,
            p.action,
            p.gesture,
            p.separation,
            [_point(hand) for hand in p.p_WH],
            p.contacts,
            [shown(g.sign, g.shown, g.answered) for g in p.gestures],
        )

    def from_ros(self, ros: Any) -> Truth:
        n = len(ros.place)
        if not len(ros.blemished) == len(ros.centers) == len(ros.radius) == n <= MAX_ONIONS:
            raise DecodeError(f"truth: lists of {n} onions differ in length or exceed {MAX_ONIONS}")
        if len(ros.by_human) not in (0, n) or len(ros.person) > 1:
            raise DecodeError("truth: by_human must name all onions or none, and there is at most one person")
        if len(ros.contact_log) > MAX_ONIONS:
            raise DecodeError(f"contact log: {len(ros.contact_log)} lines, at most {MAX_ONIONS} are allowed")
        centers = np.array([(p.x, p.y, p.z) for p in ros.centers], dtype=np.float64).reshape(n, 3)
        return Truth(
            cdr.seconds(ros.stamp, "stamp"),
            _flags(ros.blemished),
            tuple(cdr.text(p, "place") for p in ros.place),
            cdr.frozen(centers, "centers"),
            cdr.vector(ros.radius, n, "radius"),
            ros.arm_contacts,
            tuple(cdr.text(line, "contact_log") for line in ros.contact_log),
            _flags(ros.by_human),
            self._read_person(ros.person[0]) if ros.person else None,
        )

    def _read_person(self, p: Any) -> PersonTruth:
        if len(p.gestures) > MAX_SIGNS:
            raise DecodeError(f"gestures: {len(p.gestures)}, at most {MAX_SIGNS} are allowed")
        return PersonTruth(
            cdr.text(p.name, "name"),
            p.fatigued,
            p.action,
            _word(p.gesture, _GESTURES, "gesture"),
            cdr.finite(p.separation, "separation"),
            cdr.frozen(np.array([_xyz(hand, "hands") for hand in p.hands]), "hands"),
            p.contacts,
            tuple(
                ShownGesture(
                    _word(g.sign, _GESTURES[1:], "sign"),
                    cdr.finite(g.shown, "shown"),
                    cdr.finite(g.answered, "answered"),
                )
                for g in p.gestures
            ),
        )


def _flags(values: Any) -> Any:
    out = values.view(np.uint8) != 0
    out.setflags(write=False)
    return out
