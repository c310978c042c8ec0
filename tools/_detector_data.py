"""Rendered training and test images for the onion detector, with their labels.

Two kinds, as the detector meets them: the whole belt, and one onion held up for inspection.
Labels come from the renderer: a box round an onion's visible pixels, and how many of them show
a blemish.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from cell.config import CellConfig, load
from cell.frames import Array, Pinhole, from_quaternion, look_at, pose, rot_z
from cell.motion.planner import Planner
from cell.motion.views import InspectionViews
from hil.sim.camera import sense
from hil.sim.physics import bullet
from hil.sim.render.renderer import Image, Lighting, make_renderer
from hil.sim.world import LABELS, ONION_LABEL, World

MIN_PIXELS = 80
BLEMISH_PIXELS = 40
HELD_SHARE = 0.35
TRAINING_SHARE = 0.8
_PER_WORLD = 40
_AWAY = pose(p=(0.0, 0.0, -20.0))


@dataclass(frozen=True)
class Sample:
    """One image with its truth.

    Attributes:
        rgb: (H, W, 3) uint8. depth: (H, W) float32 [m].
        boxes: (G, 4) float32 x0, y0, x1, y1 [px], outer pixel centres.
        blemish: (G,) int, visible blemished pixels. p_WO: (G, 3) [m]. held: (G,) bool.
        on_belt: (G,) bool. visible: (G,) share of the whole silhouette that is seen, about 0..1.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    boxes: NDArray[np.float32]
    blemish: NDArray[np.int64]
    p_WO: Array
    held: NDArray[np.bool_]
    on_belt: NDArray[np.bool_]
    visible: NDArray[np.float64]


def generate(count: int, seed: int, randomise: bool) -> list[Sample]:
    """`count` samples. With `randomise` light, colours and camera pose vary, and most onions are
    blemished; without, everything is as in a round."""
    config = load()
    if randomise:
        config = replace(config, onions=replace(config.onions, blemished_share=TRAINING_SHARE))
    views, planner = InspectionViews(config), Planner(config)
    rng = np.random.default_rng([seed, 0xDE7EC7])
    out: list[Sample] = []
    while len(out) < count:
        world = World(config, int(rng.integers(2**62)), 15)
        renderer = make_renderer("gl", world.client, world.scene)
        try:
            for _ in range(min(_PER_WORLD, count - len(out))):
                out.append(_sample(world, renderer, views, planner, config, rng, randomise))
        finally:
            renderer.close()
            world.close()
    return out


def generate_parallel(count: int, seed: int, randomise: bool, workers: int = 2) -> list[Sample]:
    """As `generate`, by several processes; the result depends on `workers`' number."""
    shares = [count // workers + (i < count % workers) for i in range(workers)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        parts = pool.map(generate, shares, [seed + 1000 * i for i in range(workers)], [randomise] * workers)
        return [sample for part in parts for sample in part]


def _sample(world, renderer, views, planner, config: CellConfig, rng, randomise: bool) -> Sample:  # type: ignore[no-untyped-def]
    held = int(rng.integers(15)) if rng.random() < HELD_SHARE else None
    _arrange(world, views, planner, config, rng, held, randomise)
    camera = config.cameras["belt"]
    position, target = np.array(camera.position), np.array(camera.target)
    turn = np.eye(3)
    if randomise:
        renderer.lighting = _lighting(rng)
        position = position + rng.normal(0, 0.015, 3)
        target = target + rng.normal(0, 0.02, 3)
        turn = rot_z(rng.normal(0, 0.03))
    X_WC = look_at(position, target) @ pose(turn)
    pinhole = Pinhole.from_hfov(camera.width, camera.height, camera.hfov)
    image = renderer.render(X_WC, pinhole, 0.1, 5.0)
    if randomise:
        image = _recolour(image, rng)
    rgb, depth = sense(image, camera, rng)
    return _label(world, image, rgb, depth, held, X_WC, pinhole.fx)


def _arrange(world, views, planner, config: CellConfig, rng, held: int | None, randomise: bool) -> None:  # type: ignore[no-untyped-def]
    """Put arm and onions somewhere plausible."""
    belt, c = config.belt, config.bin
    camera_position = np.array(config.cameras["belt"].position)
    chosen: list[Array] = []
    count = int(rng.integers(1, 16))
    for index in range(15):
        if index == held:
            continue
        X = _AWAY
        if len(chosen) < count:
            for _ in range(30):
                p = np.array(
                    [rng.uniform(belt.pick_x[0] - 0.02, belt.pick_x[1] + 0.03), rng.uniform(-0.35, 0.35)]
                )
                if all(np.linalg.norm(p - o) > 0.082 for o in chosen):
                    chosen.append(p)
                    X = pose(_random_rotation(rng), [*p, belt.top_z + 0.95 * world.onions[index].radius])
                    break
        elif rng.random() < 0.3:
            q = np.array(c.center[:2]) + rng.uniform(-0.08, 0.08, 2)
            X = pose(_random_rotation(rng), [*q, c.center[2] - c.size[2] + 0.04 + rng.uniform(0, 0.08)])
        world.set_onion_pose(index, X)
    q = np.array(config.arm.home)
    opening = config.gripper.stroke
    if held is not None:
        view = views.views[int(rng.integers(len(views.views)))]
        q = view.q + rng.normal(0, 0.02 if randomise else 0.003, 6)
        if randomise and rng.random() < 0.5:
            q = _shown_anywhere(planner, camera_position, rng, view.q)
        opening = 1.96 * world.onions[held].radius
    elif randomise and rng.random() < 0.3:
        q = q + rng.normal(0, 0.25, 6)
    world.arm.place(q)
    for name in ("left_finger_joint", "right_finger_joint"):
        bullet.resetJointState(world.robot, world.joints[name], opening / 2, physicsClientId=world.client)
    if held is not None:
        state = bullet.getLinkState(
            world.robot, world.joints["tcp_joint"], computeForwardKinematics=1, physicsClientId=world.client
        )
        X_WT = pose(from_quaternion(state[5]), state[4])
        world.set_onion_pose(held, X_WT @ pose(_random_rotation(rng), rng.normal(0, 0.003, 3)))


def _label(world, image: Image, rgb, depth, held: int | None, X_WC: Array, fx: float) -> Sample:  # type: ignore[no-untyped-def]
    assert image.marks is not None
    boxes, blemish, centres, in_hand, on_belt, visible = [], [], [], [], [], []
    for index in range(15):
        mask = image.labels == ONION_LABEL + index
        if int(mask.sum()) < MIN_PIXELS:
            continue
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        boxes.append((columns[0], rows[0], columns[-1], rows[-1]))
        blemish.append(int((image.marks & mask).sum()))
        centres.append(world.onion_pose(index)[:3, 3])
        in_hand.append(index == held)
        on_belt.append(world.place_of(index) == "belt")
        distance = float(np.linalg.norm(centres[-1] - X_WC[:3, 3]))
        visible.append(float(mask.sum()) / (np.pi * (world.onions[index].radius * fx / distance) ** 2))
    return Sample(
        rgb,
        depth,
        np.array(boxes, np.float32).reshape(-1, 4),
        np.array(blemish, np.int64),
        np.array(centres).reshape(-1, 3),
        np.array(in_hand, bool),
        np.array(on_belt, bool),
        np.array(visible, float),
    )


def _shown_anywhere(planner: Planner, p_WC: Array, rng: np.random.Generator, q_near: Array) -> Array:
    """Arm pose (6,) [rad] that shows a held onion somewhere else, so that no place is learnt by heart."""
    for _ in range(40):
        p_WT = rng.uniform((0.15, -0.30, -0.05), (0.45, 0.30, 0.35))
        z_T = (p_WC - p_WT) / np.linalg.norm(p_WC - p_WT) + rng.normal(0, 0.8, 3)
        z_T /= np.linalg.norm(z_T)
        x_T = np.cross(z_T, rng.normal(size=3))
        x_T /= np.linalg.norm(x_T)
        found = planner.kinematics.ik(pose(np.column_stack([x_T, np.cross(z_T, x_T), z_T]), p_WT), q_near)
        free = [q for q in found if planner.collision.clearance(q[None], held_radius=0.04)[0] > 0.0]
        if free:
            return free[0]
    return q_near


def _lighting(rng: np.random.Generator) -> Lighting:
    tint = rng.uniform(0.85, 1.1, 3)
    return Lighting(
        direction=(float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1)), float(rng.uniform(0.5, 1.2))),
        color=(float(tint[0]), float(tint[1]), float(tint[2])),
        ambient=float(rng.uniform(0.35, 0.7)),
        diffuse=float(rng.uniform(0.35, 0.8)),
        specular=float(rng.uniform(0.0, 0.3)),
        shadows=bool(rng.random() < 0.7),
    )


def _recolour(image: Image, rng: np.random.Generator) -> Image:
    """Other colours and a coarse pattern on belt and floor, whose look a detector must not learn."""
    rgb = image.rgb.astype(np.float32)
    for label in (LABELS["belt"], LABELS["floor"], LABELS["bin"]):
        mask = image.labels == label
        gain, lift = rng.uniform(0.5, 1.6, 3), rng.uniform(-10, 50)
        noise = cv2.resize(rng.normal(0, rng.uniform(0, 14), (24, 32)).astype(np.float32), (640, 480))
        rgb[mask] = rgb[mask] * gain + lift + noise[mask][:, None]
    rgb *= rng.uniform(0.75, 1.2)
    return Image(np.clip(rgb, 0, 255).astype(np.uint8), image.depth, image.labels, image.marks)


def _random_rotation(rng: np.random.Generator) -> Array:
    q = rng.normal(size=4)
    R: Array = from_quaternion(q / np.linalg.norm(q))
    return R


__all__ = ["BLEMISH_PIXELS", "Sample", "generate", "generate_parallel"]
