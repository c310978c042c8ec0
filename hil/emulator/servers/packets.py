"""Packets of the primary, secondary and realtime interfaces as bytes.

A message is: int32 size with these four bytes, uint8 type, content; everything is big endian.
Source: Universal Robots, "Remote control via TCP/IP" and its sheet of client interfaces.
"""

from __future__ import annotations

import struct
import zlib

from hil.emulator.controller import Controller
from hil.emulator.interfaces import RuntimeState, SafetyMode
from hil.emulator.outputs import Outputs
from hil.emulator.safety import POWER_CUT

_STATE, _MESSAGE = 16, 20
_TEXT, _POPUP, _VERSION, _ERROR, _KEY, _EXCEPTION = 0, 2, 3, 6, 7, 10
_SOURCE_CONTROLLER, _SOURCE_RTMACHINE = -2, 7
_US = 1e6
_ACCELERATION = 40.0
"""Largest joint acceleration told [rad/s^2]; not a published figure."""
_DEFAULTS = (1.05, 1.4, 0.25, 1.2)
"""Defaults of move commands: joint speed and acceleration, tool speed and acceleration."""
_TOOL_LENGTH = 1.0
"""Equivalent radius [m]."""
_UNCALIBRATED, _CALIBRATED = 0, 2
"""Nothing is known of the arm before there is power on it; afterwards its table holds ("linearised")."""
_BOX = 3
_E_SERIES = 1


def _package(kind: int, content: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(content), kind) + content


def _part(kind: int, content: bytes) -> bytes:
    """Sub-packet of a state."""
    return struct.pack(">IB", 5 + len(content), kind) + content


def _stamp(controller: Controller) -> int:
    return int(controller.now * _US)


# -- messages -----------------------------------------------------------------------------------


def version_message(controller: Controller, version: tuple[int, int, int, int], date: str) -> bytes:
    """The first one on a new connection."""
    name = b"URControl"
    major, minor, bugfix, build = version
    content = struct.pack(">QbBB", _stamp(controller), _SOURCE_CONTROLLER, _VERSION, len(name)) + name
    content += struct.pack(">BBii", major, minor, bugfix, build) + date.encode("ascii")
    return _package(_MESSAGE, content)


def text_message(controller: Controller, text: str) -> bytes:
    """A line for the log."""
    head = struct.pack(">QbB", _stamp(controller), _SOURCE_RTMACHINE, _TEXT)
    return _package(_MESSAGE, head + text.encode("utf-8"))


def error_message(controller: Controller, code: int, level: int, text: str) -> bytes:
    """An error code with its report level (1 info, 2 warning, 3 violation, 4 fault) and a text."""
    head = struct.pack(">QbB", _stamp(controller), _SOURCE_RTMACHINE, _ERROR)
    return _package(_MESSAGE, head + struct.pack(">iiiII", code, 0, level, 0, 0) + text.encode("utf-8"))


def key_message(controller: Controller, title: str, text: str) -> bytes:
    """A program started or stopped."""
    head = struct.pack(">QbB", _stamp(controller), _SOURCE_RTMACHINE, _KEY)
    name = title.encode("ascii")
    return _package(_MESSAGE, head + struct.pack(">iiB", 0, 0, len(name)) + name + text.encode("utf-8"))


def exception_message(controller: Controller, text: str) -> bytes:
    """A runtime exception; programs run natively, so line and column are unknown."""
    head = struct.pack(">QbB", _stamp(controller), _SOURCE_RTMACHINE, _EXCEPTION)
    return _package(_MESSAGE, head + struct.pack(">ii", -1, -1) + text.encode("utf-8"))


def popup_message(controller: Controller, title: str, text: str) -> bytes:
    """A pop-up, as text that needs no answer."""
    head = struct.pack(">QbB", _stamp(controller), _SOURCE_RTMACHINE, _POPUP)
    name = title.encode("utf-8")
    body = struct.pack(">IBBBBB", 0, 0, 0, 0, 0, len(name)) + name + text.encode("utf-8")
    return _package(_MESSAGE, head + body)


# -- state --------------------------------------------------------------------------------------


def state_message(controller: Controller, outputs: Outputs) -> bytes:
    """The robot's state with all its sub-packets."""
    parts = (
        _mode_data(controller, outputs),
        _joint_data(controller, outputs),
        _masterboard_data(controller, outputs),
        _cartesian_info(controller, outputs),
        _kinematics_info(controller),
        _configuration_data(controller),
    )
    return _package(_STATE, b"".join(parts))


def _mode_data(c: Controller, outputs: Outputs) -> bytes:
    bits = (
        True,
        True,
        c.power.on,
        c.safety_mode in POWER_CUT[:2],
        c.safety_mode is SafetyMode.PROTECTIVE_STOP,
        c.runtime.active and c.runtime_state is not RuntimeState.PAUSED,
        c.runtime_state is RuntimeState.PAUSED,
    )
    content = struct.pack(">Q7?", _stamp(c), *bits)
    content += struct.pack(">bB", c.robot_mode, 0)
    return _part(0, content + struct.pack(">3dB", c.io.speed_slider, outputs.scaling(), 1.0, 0))


def _joint_data(c: Controller, outputs: Outputs) -> bytes:
    voltage = outputs.voltage()
    rows = zip(
        c.measured.q.tolist(),
        c.mover.q.tolist(),
        c.measured.qd.tolist(),
        outputs.currents(),
        outputs.getters["joint_temperatures"](),
        strict=True,
    )
    content = b"".join(
        struct.pack(">3d4fB", q, target, qd, current, voltage, warm, warm, c.joint_mode)
        for q, target, qd, current, warm in rows
    )
    return _part(1, content)


def _masterboard_data(c: Controller, outputs: Outputs) -> bytes:
    io = c.io
    content = struct.pack(">II", io.digital_in, io.digital_out)
    content += struct.pack(">BB2d", 1, 1, *io.analog_in)
    content += struct.pack(">BB2d", io.analog_out_type & 1, io.analog_out_type >> 1 & 1, *io.analog_out)
    warm = outputs.getters["joint_temperatures"]()[0]
    content += struct.pack(">4f", warm, outputs.voltage(), outputs.current(), 0.0)
    reduced = c.safety_mode is SafetyMode.REDUCED
    return _part(3, content + struct.pack(">BBBIBBB", c.safety_mode, reduced, 0, 0, 0, 0, 0))


def _cartesian_info(c: Controller, outputs: Outputs) -> bytes:
    return _part(4, struct.pack(">12d", *outputs.actual().pose, *c.tcp.tolist()))


def _kinematics_info(c: Controller) -> bytes:
    model = c.model
    tables = [[0.0] * 6, model.a.tolist(), model.d.tolist(), model.alpha.tolist()]
    sums = [zlib.crc32(struct.pack(">4d", *(table[i] for table in tables))) for i in range(len(model.a))]
    content = struct.pack(">6I", *sums) + b"".join(struct.pack(">6d", *table) for table in tables)
    return _part(5, content + struct.pack(">I", _CALIBRATED if c.power.on else _UNCALIBRATED))


def _configuration_data(c: Controller) -> bytes:
    model = c.model
    content = b"".join(struct.pack(">2d", -limit, limit) for limit in model.q_max.tolist())
    content += b"".join(struct.pack(">2d", limit, _ACCELERATION) for limit in model.qd_max.tolist())
    content += struct.pack(">5d", *_DEFAULTS, _TOOL_LENGTH)
    for table in (model.a.tolist(), model.d.tolist(), model.alpha.tolist(), [0.0] * 6):
        content += struct.pack(">6d", *table)
    return _part(6, content + struct.pack(">4i", 0, _BOX, model.robot_type, _E_SERIES))


# -- realtime -----------------------------------------------------------------------------------

_ZEROS6 = "zeros6"
_REALTIME = (
    "timestamp",
    "target_q", "target_qd", "target_qdd", "target_current", "target_moment",
    "actual_q", "actual_qd", "actual_current", "joint_control_output",
    "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "target_TCP_pose", "target_TCP_speed",
    "actual_digital_input_bits", "joint_temperatures", "actual_execution_time", "zero",
    "robot_mode", "joint_mode", "safety_mode", _ZEROS6, "actual_tool_accelerometer", _ZEROS6,
    "speed_scaling", "actual_momentum", "zero", "zero",
    "actual_main_voltage", "actual_robot_voltage", "actual_robot_current", "actual_joint_voltage",
    "actual_digital_output_bits", "runtime_state", "elbow_position", "elbow_velocity",
    "safety_status", "zero", "zero", "zero", "payload", "payload_cog", "payload_inertia",
)  # fmt: skip
_PAD = {"zero": (0.0,), _ZEROS6: (0.0,) * 6}
REALTIME_SIZE = 1220


def realtime_packet(outputs: Outputs) -> bytes:
    """The realtime interface's packet: a size and 152 doubles."""
    values: list[float] = []
    for name in _REALTIME:
        values += _PAD[name] if name in _PAD else outputs.getters[name]()
    return struct.pack(f">i{len(values)}d", 4 + 8 * len(values), *values)
