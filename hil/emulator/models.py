"""The arms that can be emulated: kinematics, limits, and how the controller names them.

Denavit-Hartenberg parameters, masses and limits are those that Universal Robots publish ("DH
parameters for calculations of kinematics and dynamics", data sheets).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cell.errors import ConfigError, one_of
from cell.frames import Array

_DEG = np.pi / 180.0


@dataclass(frozen=True)
class Model:
    """One arm.

    Attributes:
        name: as the dashboard says it.
        a, d, alpha: Denavit-Hartenberg parameters, shape (6,) [m], [m], [rad].
        q_max: largest joint angle either way, shape (6,) [rad].
        qd_max: largest joint speed, shape (6,) [rad/s].
        effort_max: largest joint torque, shape (6,) [Nm].
        mass: of the six moving links together [kg].
        payload_max: [kg].
        robot_type: number in the configuration data of the primary interface.
        serial: digits.
    """

    name: str
    a: Array
    d: Array
    alpha: Array
    q_max: Array
    qd_max: Array
    effort_max: Array
    mass: float
    payload_max: float
    robot_type: int
    serial: str


_ALPHA = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])

UR3E = Model(
    name="UR3",
    a=np.array([0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0]),
    d=np.array([0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921]),
    alpha=_ALPHA,
    q_max=np.full(6, 360.0) * _DEG,
    qd_max=np.array([180.0, 180.0, 180.0, 360.0, 360.0, 360.0]) * _DEG,
    effort_max=np.array([54.0, 54.0, 28.0, 9.0, 9.0, 9.0]),
    mass=8.7985,
    payload_max=3.0,
    robot_type=3,
    serial="20235300001",
)
UR5E = Model(
    name="UR5",
    a=np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]),
    d=np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996]),
    alpha=_ALPHA,
    q_max=np.full(6, 360.0) * _DEG,
    qd_max=np.full(6, 180.0) * _DEG,
    effort_max=np.array([150.0, 150.0, 150.0, 28.0, 28.0, 28.0]),
    mass=17.7,
    payload_max=5.0,
    robot_type=1,
    serial="20235500001",
)
MODELS = {"ur3e": UR3E, "ur5e": UR5E}


def model(name: str) -> Model:
    """By the name users write.

    Raises:
        ConfigError: there is no such arm.
    """
    if name not in MODELS:
        raise ConfigError(f"model of the arm: {one_of(name, MODELS)}")
    return MODELS[name]
