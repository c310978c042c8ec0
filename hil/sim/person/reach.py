"""From a stance to the pose of every bone: arms by inverse kinematics, the rest forwards.

An arm is two rods: the wrist follows from the grip point, the elbow lies on a circle, its place
on it is the swivel. The twist that is left between forearm and hand is spread along the forearm,
as the real radius does; a wrist bends 25 degrees at most, the hand gives way beyond.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cell.frames import Array, rot_x, rot_y, rot_z
from hil.sim.person.body import Body
from hil.sim.person.hands import finger_turns, pivot
from hil.sim.person.stance import Arm, Stance

_MAX_BEND = np.deg2rad(25.0)
_ROUNDS = 6
"""Times that an arm is solved; with 2 the grip point is up to 30 mm off when the wrist is at its limit."""
_FULL = 0.995
"""An arm is not stretched further than this."""
_GRIP = (-0.004, 0.062)
"""The grip point from the middle knuckle: along the fingers, out of the palm [m]. A ball of 70 mm there
touches palm and fingers of the shape "grip" without cutting far into them."""
_SWIVELS = np.deg2rad(np.arange(-20.0, 141.0, 10.0))
_SPINE = {"spine05": 0.45, "spine04": 0.2, "spine03": 0.2, "spine02": 0.15}
"""How a bend of the trunk spreads over its bones."""


@dataclass(frozen=True, eq=False)
class Pose:
    """All bones in the world: rotations relative to rest, G (B, 3, 3), and heads, p (B, 3) [m]."""

    G: Array
    p: Array


class Poser:
    """Poses one body.

    Args:
        body: whose. floor_z: height of the floor in the world [m].
    """

    def __init__(self, body: Body, floor_z: float) -> None:
        self.body, self.floor_z = body, floor_z
        self._rig = rig = body.rig
        self._pivot = rig.p.copy()
        for side in "LR":
            for finger in range(2, 6):
                self._pivot[rig.index(f"finger{finger}-1.{side}")] = pivot(rig, side, finger)
        self._hands = {side: _Hand(body, side) for side in "LR"}

    # -- what is asked -----------------------------------------------------------------------------

    def pose(self, stance: Stance) -> Pose:
        """The bones of a stance."""
        turns = self._trunk(stance)
        G, p = self._forward(turns)
        # Legs that close or swing move the soles; the arms are solved for where the body then is.
        lift = np.array([0.0, 0.0, -float(self.body.points(G, p)[:, 2].min())])
        for side in "LR":
            arm = stance.arm(side)
            self._arm(replace(arm, p=arm.p - lift), side, G, p, turns)
        G, p = self._forward(turns)
        R_WP = rot_z(stance.yaw)
        return Pose(R_WP @ G, p @ R_WP.T + np.array([stance.x, stance.y, self.floor_z]) + lift)

    def grip(self, pose: Pose, side: str) -> Array:
        """The grip point of a hand in the world (3,) [m]."""
        wrist = self._hands[side].wrist
        out: Array = pose.p[wrist] + pose.G[wrist] @ self._hands[side].grip0
        return out

    def shoulder(self, stance: Stance, side: str) -> tuple[Array, float]:
        """The shoulder in P (3,) [m] and how far the wrist can be from it [m]."""
        _, p = self._forward(self._trunk(stance))
        hand = self._hands[side]
        return p[hand.shoulder], _FULL * (hand.upper + hand.fore)

    def hanging(self, side: str) -> Arm:
        """An arm that hangs at the side."""
        hand = self._hands[side]
        out = 1.0 if side == "L" else -1.0
        p = self._rig.p[hand.shoulder] + np.array([0.06, 0.13 * out, -0.96 * (hand.upper + hand.fore) - 0.06])
        return Arm(p, hand_frame((0.15, 0.0, -1.0), (0.1, -out, 0.0)), np.deg2rad(-10.0))

    def best_swivel(self, stance: Stance, side: str) -> Stance:
        """The stance with this arm's elbow where forearm and wrist twist least."""
        arm = stance.arm(side)
        turns = self._trunk(stance)
        G, p = self._forward(turns)
        costs = [self._solve(replace(arm, swivel=float(s)), side, G, p)[1] for s in _SWIVELS]
        return stance.with_arm(side, replace(arm, swivel=float(_SWIVELS[int(np.argmin(costs))])))

    def landmarks(self, pose: Pose, side: str) -> Array:
        """The 21 landmarks of a hand in MediaPipe's order, in the world (21, 3) [m]."""
        rig, hand = self._rig, self._hands[side]
        out = [pose.p[hand.wrist]]
        for finger in range(1, 6):
            first = rig.index(f"finger{finger}-1.{side}")
            root = pose.p[first] if finger == 1 else self._moved(pose, first, self._pivot[first])
            out += [root, pose.p[first + 1], pose.p[first + 2]]
            out.append(self._moved(pose, first + 2, hand.tips[finger - 1]))
        return np.array(out)

    # -- internals ---------------------------------------------------------------------------------

    def _moved(self, pose: Pose, bone: int, p0: Array) -> Array:
        out: Array = pose.p[bone] + pose.G[bone] @ (p0 - self._rig.p[bone])
        return out

    def _trunk(self, s: Stance) -> dict[int, Array]:
        """Turns of trunk, head and legs, each in P's axes relative to the bone before."""
        rig = self._rig
        turns = {
            rig.index(name): rot_z(s.twist * share) @ rot_y(s.lean * share) for name, share in _SPINE.items()
        }
        turns[rig.index("neck02")] = rot_y(0.5 * (s.nod - 0.3 * s.lean))
        turns[rig.index("head")] = rot_y(0.5 * (s.nod - 0.3 * s.lean))
        if s.stride:
            for side, sign in (("L", 1.0), ("R", -1.0)):
                swing = 0.42 * sign * s.stride
                turns[rig.index(f"upperleg01.{side}")] = rot_y(-swing)
                turns[rig.index(f"lowerleg01.{side}")] = rot_y(max(0.0, -swing) * 1.2)
        for side, out in (("L", 1.0), ("R", -1.0)):
            # Bodies rest with their feet apart; standing at a belt they are not.
            close = rot_x(-0.14 * out)
            bone = rig.index(f"upperleg01.{side}")
            turns[bone] = turns[bone] @ close if bone in turns else close
        return turns

    def _forward(self, turns: dict[int, Array]) -> tuple[Array, Array]:
        """Forward kinematics in P: a turn is relative to the parent and given in P's axes at rest."""
        rig = self._rig
        count = len(rig.bones)
        G, p = np.empty((count, 3, 3)), np.empty((count, 3))
        for i, parent in enumerate(rig.parents):
            if parent < 0:
                G[i], p[i] = np.eye(3), rig.p[i]
                continue
            G[i] = G[parent] @ turns[i] if i in turns else G[parent]
            centre = p[parent] + G[parent] @ (self._pivot[i] - rig.p[parent])
            p[i] = centre + G[i] @ (rig.p[i] - self._pivot[i])
        return G, p

    def _arm(self, arm: Arm, side: str, G: Array, p: Array, turns: dict[int, Array]) -> None:
        """Turns of one arm's bones."""
        hand, rig = self._hands[side], self._rig
        found, _ = self._solve(arm, side, G, p)
        chain = [f"{n}.{side}" for n in ("upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist")]
        before = G[rig.parents[hand.shoulder]]
        for name, wanted in zip(chain, found, strict=True):
            turns[rig.index(name)] = before.T @ wanted
            before = wanted
        for bone, turn in finger_turns(rig, side, arm.fingers).items():
            turns[bone] = rig.R[bone] @ turn @ rig.R[bone].T

    def _solve(self, arm: Arm, side: str, G: Array, p: Array) -> tuple[list[Array], float]:
        """Rotations of the five bones of an arm relative to rest, in P, and how unnatural it is."""
        hand, rig = self._hands[side], self._rig
        shoulder, body = p[hand.shoulder], G[rig.parents[hand.shoulder]]
        G_hand = arm.R @ hand.R0.T
        for _ in range(_ROUNDS):  # the wrist's limit turns the hand, which moves the wrist
            wrist = arm.p - G_hand @ hand.grip0
            u, f, n = _elbow(shoulder, wrist, hand.upper, hand.fore, arm.swivel, side)
            G_fore = _frame(f, n) @ hand.F_fore.T
            twist, bend, G_hand = _wrist(G_fore, arm.R @ hand.R0.T, hand.f0)
        G_upper = _frame(u, n) @ hand.F_upper.T
        roll, _, _ = _wrist(body, G_upper, hand.u0)
        cost = (
            max(0.0, abs(twist) - 0.9) * 3.0 + 0.5 * abs(twist) + 3.0 * max(0.0, bend - _MAX_BEND)
            + 0.4 * max(0.0, abs(roll) - 0.8) + 0.25 * abs(arm.swivel - 0.4)
        )  # fmt: skip
        return [
            G_upper @ _about(hand.u0, -0.6 * roll),
            G_upper,
            G_fore @ _about(hand.f0, 0.15 * twist),
            G_fore @ _about(hand.f0, 0.55 * twist),
            G_hand,
        ], cost


class _Hand:
    """What is fixed of one arm: bones, lengths, axes at rest."""

    def __init__(self, body: Body, side: str) -> None:
        rig = body.rig
        self.shoulder, elbow = rig.index(f"upperarm01.{side}"), rig.index(f"lowerarm01.{side}")
        self.wrist = rig.index(f"wrist.{side}")
        S, E, W = rig.p[self.shoulder], rig.p[elbow], rig.p[self.wrist]
        self.upper, self.fore = float(np.linalg.norm(E - S)), float(np.linalg.norm(W - E))
        self.u0, self.f0 = (E - S) / self.upper, (W - E) / self.fore
        hinge = rig.R[elbow][:, 0]
        self.F_upper, self.F_fore = _frame(self.u0, hinge), _frame(self.f0, hinge)
        knuckles = [pivot(rig, side, finger) for finger in range(2, 6)]
        along = knuckles[1] - W
        across = knuckles[3] - knuckles[0]
        out = np.cross(along, across) * (1.0 if side == "R" else -1.0)
        self.R0 = hand_frame(along, out)
        self.grip0 = along + self.R0 @ np.array([_GRIP[0], 0.0, _GRIP[1]])
        self.tips = [self._tip(body, rig.index(f"finger{finger}-3.{side}")) for finger in range(1, 6)]

    @staticmethod
    def _tip(body: Body, bone: int) -> Array:
        """A fingertip at rest (3,) [m]: 4 mm inside the farthest points that follow its last bone."""
        follows, rest = body.region()
        own = rest[follows == bone].astype(float)
        along = body.rig.R[bone][:, 1]
        far = own[np.argsort((own - body.rig.p[bone]) @ along)[-8:]].mean(axis=0)
        out: Array = far - 0.004 * along
        return out


def hand_frame(along: object, palm: object) -> Array:
    """Orientation of a hand (3, 3) from the direction of the fingers' roots and that out of the palm."""
    x = np.asarray(along, float)
    x = x / np.linalg.norm(x)
    z = np.asarray(palm, float)
    z = z - (z @ x) * x
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def _frame(along: Array, normal: Array) -> Array:
    n = normal - (normal @ along) * along
    n = n / np.linalg.norm(n)
    return np.column_stack([along, n, np.cross(along, n)])


def _elbow(S: Array, W: Array, a: float, b: float, swivel: float, side: str) -> tuple[Array, Array, Array]:
    """Directions of upper arm and forearm, and the elbow's axis, each (3,)."""
    reach = W - S
    far = float(np.linalg.norm(reach))
    w = reach / max(far, 1e-9)
    far = float(np.clip(far, abs(a - b) * 1.02 + 1e-3, _FULL * (a + b)))
    along = (a * a - b * b + far * far) / (2.0 * far)
    radius = np.sqrt(max(a * a - along * along, 1e-9))
    down = np.array([-0.15, 0.0, -1.0])
    down = down - (down @ w) * w
    if np.linalg.norm(down) < 0.05:
        down = np.array([-1.0, 0.0, 0.0]) - (-w[0]) * w
    down = down / np.linalg.norm(down)
    out = np.cross(w, down)
    if out[1] * (1.0 if side == "L" else -1.0) < 0.0:
        out = -out
    E = S + along * w + radius * (np.cos(swivel) * down + np.sin(swivel) * out)
    wrist = S + far * w
    u, f = (E - S) / a, (wrist - E) / b
    n = np.cross(u, f)
    return u, f, n / max(float(np.linalg.norm(n)), 1e-9)


def _wrist(G_fore: Array, G_hand: Array, axis: Array) -> tuple[float, float, Array]:
    """Twist about `axis` and bend [rad] from one bone to the next, and the next with its bend limited."""
    rel = G_fore.T @ G_hand
    w = np.sqrt(max(0.0, 1.0 + np.trace(rel))) / 2.0
    v = np.array([rel[2, 1] - rel[1, 2], rel[0, 2] - rel[2, 0], rel[1, 0] - rel[0, 1]]) / (4.0 * max(w, 1e-6))
    twist = 2.0 * float(np.arctan2(v @ axis, w))
    twist = (twist + np.pi) % (2 * np.pi) - np.pi
    swing = rel @ _about(axis, twist).T
    bend = float(np.arccos(np.clip((np.trace(swing) - 1.0) / 2.0, -1.0, 1.0)))
    if bend <= _MAX_BEND:
        return twist, bend, G_hand
    pole = np.array([swing[2, 1] - swing[1, 2], swing[0, 2] - swing[2, 0], swing[1, 0] - swing[0, 1]])
    pole = pole / max(float(np.linalg.norm(pole)), 1e-9)
    return twist, bend, G_fore @ _about(pole, _MAX_BEND) @ _about(axis, twist)


def _about(axis: Array, angle: float) -> Array:
    """Rotation by `angle` [rad] about a unit axis (3,) (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out: Array = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
    return out
