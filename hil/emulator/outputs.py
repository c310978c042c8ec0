"""What the controller reports: a getter for every output field, values as flat sequences.

Electrical values are estimates from the joints' torques: they move as the real ones do, and are
not those of a real arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt

from hil.emulator.chain import Chain, Motion
from hil.emulator.controller import Controller
from hil.emulator.interfaces import PERIOD, RobotMode
from hil.emulator.poses import turn_back
from hil.emulator.watch import MAX_DEVIATION, deviation
from hil.rtde.fields import fields

Getter = Callable[[], Sequence[float]]
_VOLTAGE = 48.0
_TORQUE_PER_CURRENT = 10.0
"""Joint torque constant behind the gear, about that of these arms [Nm/A]."""
_IDLE_POWER = 90.0
"""Of controller and released brakes [W]."""
_TEMPERATURE = 30.0
_CONFIGURABLE = 8
_JOINTS = 6


class Outputs:
    """Getters by field name. What costs is computed once a cycle, and only if asked for."""

    def __init__(self, controller: Controller) -> None:
        self._c = controller
        self._chain = Chain(controller.model)
        self._tool = controller.tcp
        self._stamp_actual = self._stamp_target = -1
        self._actual: Motion | None = None
        self._target: Motion | None = None
        self.getters: dict[str, Getter] = self._joints() | self._tcp() | self._state() | self._wiring()
        self.getters |= self._registers()

    def actual(self) -> Motion:
        """Of the measured joints."""
        if self._actual is None or self._stamp_actual != self._c.cycles or self._retooled():
            measured = self._c.measured
            self._actual = self._chain.motion(measured.q, measured.qd)
            self._stamp_actual = self._c.cycles
        return self._actual

    def target(self) -> Motion:
        """Of the set-point."""
        if self._target is None or self._stamp_target != self._c.cycles or self._retooled():
            self._target = self._chain.motion(self._c.mover.q, self._c.mover.qd)
            self._stamp_target = self._c.cycles
        return self._target

    def _retooled(self) -> bool:
        if self._tool is self._c.tcp:
            return False
        self._tool = self._c.tcp
        self._chain.tool(self._tool)
        self._stamp_actual = self._stamp_target = -1
        return True

    def scaling(self) -> float:
        """RTDE `speed_scaling`: its product with the slider's fraction is the actual ratio."""
        return min(1.0, self._c.speed_scaling / self._c.io.speed_slider)

    # -- estimates --------------------------------------------------------------------------------

    def currents(self) -> list[float]:
        """Of the joints [A], length 6."""
        return [effort / _TORQUE_PER_CURRENT for effort in self._c.measured.effort.tolist()]

    def voltage(self) -> float:
        """On the arm [V]."""
        return _VOLTAGE if self._c.power.on else 0.0

    def current(self) -> float:
        """Into the arm [A]."""
        return (_IDLE_POWER + max(0.0, self._c.observed.power)) / _VOLTAGE if self._c.power.on else 0.0

    def _momentum(self) -> float:
        """As if a third of the arm moved with the TCP [kg m/s]."""
        vx, vy, vz = self.actual().speed[:3]
        return (self._c.payload + self._c.model.mass / 3.0) * sqrt(vx * vx + vy * vy + vz * vz)

    def _acceleration(self) -> Sequence[float]:
        measured = self._c.measured
        return self._chain.acceleration(self.actual(), measured.q, measured.qd, self._c.observed.qdd)

    def _target_acceleration(self) -> Sequence[float]:
        mover = self._c.mover
        return self._chain.acceleration(self.target(), mover.q, mover.qd, mover.qdd)

    def _accelerometer(self) -> Sequence[float]:
        """Specific force at the TCP, in the axes of the flange [m/s^2]."""
        force = [g + a for g, a in zip(self._c.gravity.tolist(), self._acceleration()[:3], strict=True)]
        return turn_back(self._chain.flange(self._c.measured.q), force)

    # -- fields -----------------------------------------------------------------------------------

    def _joints(self) -> dict[str, Getter]:
        c = self._c
        return {
            "target_q": lambda: c.mover.q.tolist(),
            "target_qd": lambda: c.mover.qd.tolist(),
            "target_qdd": lambda: c.mover.qdd.tolist(),
            "target_current": self.currents,
            "target_moment": lambda: c.measured.effort.tolist(),
            "actual_q": lambda: c.measured.q.tolist(),
            "actual_qd": lambda: c.measured.qd.tolist(),
            "actual_current": self.currents,
            "actual_current_window": lambda: (c.model.effort_max / _TORQUE_PER_CURRENT).tolist(),
            "actual_current_as_torque": lambda: c.measured.effort.tolist(),
            "joint_control_output": self.currents,
            "joint_temperatures": lambda: (_TEMPERATURE,) * _JOINTS,
            "joint_mode": lambda: (c.joint_mode,) * _JOINTS,
            "actual_joint_voltage": lambda: (self.voltage(),) * _JOINTS,
            "joint_position_deviation_ratio": lambda: (deviation(c.mover, c.measured) / MAX_DEVIATION,),
            "collision_detection_ratio": lambda: (deviation(c.mover, c.measured) / MAX_DEVIATION,),
        }

    def _tcp(self) -> dict[str, Getter]:
        c = self._c
        return {
            "actual_TCP_pose": lambda: self.actual().pose,
            "actual_TCP_speed": lambda: self.actual().speed,
            "actual_TCP_force": lambda: c.measured.wrench.tolist(),
            "target_TCP_pose": lambda: self.target().pose,
            "target_TCP_speed": lambda: self.target().speed,
            "tcp_offset": lambda: c.tcp.tolist(),
            "actual_TCP_acceleration": self._acceleration,
            "target_TCP_acceleration": self._target_acceleration,
            "tcp_force_scalar": lambda: (sqrt(sum(f * f for f in c.measured.wrench.tolist()[:3])),),
            "ft_raw_wrench": lambda: c.measured.wrench.tolist(),
            "wrench_calc_from_currents": lambda: c.measured.wrench.tolist(),
            "elbow_position": lambda: self.actual().elbow,
            "elbow_velocity": lambda: self.actual().elbow_speed,
            "actual_momentum": lambda: (self._momentum(),),
            "actual_tool_accelerometer": self._accelerometer,
            "payload": lambda: (c.payload,),
            "payload_cog": lambda: c.cog.tolist(),
            "payload_inertia": lambda: c.inertia.tolist(),
            "target_gravity": lambda: c.gravity.tolist(),
            "target_base_acceleration": lambda: (0.0,) * _JOINTS,
        }

    def _state(self) -> dict[str, Getter]:
        c = self._c
        return {
            "timestamp": lambda: (c.now,),
            "control_step": lambda: (c.cycles,),
            "actual_execution_time": lambda: (c.execution_time * 1e3,),
            "target_execution_time": lambda: (PERIOD * 1e3,),
            "robot_mode": lambda: (c.robot_mode,),
            "safety_mode": lambda: (c.safety_mode,),
            "safety_status": lambda: (c.safety_mode,),
            "robot_status_bits": lambda: (c.robot_status_bits,),
            "safety_status_bits": lambda: (c.safety_status_bits,),
            "runtime_state": lambda: (c.runtime_state,),
            "speed_scaling": lambda: (self.scaling(),),
            "target_speed_fraction": lambda: (c.io.speed_slider,),
            "script_control_line": lambda: (0,),
            "time_scale_source": lambda: (0,),
        }

    def _wiring(self) -> dict[str, Getter]:
        c, io = self._c, self._c.io
        return {
            "actual_main_voltage": lambda: (_VOLTAGE,),
            "actual_robot_voltage": lambda: (self.voltage(),),
            "actual_robot_current": lambda: (self.current(),),
            "actual_robot_energy_consumed": lambda: (c.observed.used,),
            "actual_robot_braking_energy_dissipated": lambda: (c.observed.braked,),
            "actual_digital_input_bits": lambda: (io.digital_in,),
            "actual_configurable_digital_input_bits": lambda: (io.digital_in >> _CONFIGURABLE & 0xFF,),
            "actual_digital_output_bits": lambda: (io.digital_out,),
            "actual_configurable_digital_output_bits": lambda: (io.digital_out >> _CONFIGURABLE & 0xFF,),
            "analog_io_types": lambda: (io.analog_out_type << 2 | 0b11,),
            "standard_analog_input0": lambda: (io.analog_in[0],),
            "standard_analog_input1": lambda: (io.analog_in[1],),
            "standard_analog_output0": lambda: (io.analog_out[0],),
            "standard_analog_output1": lambda: (io.analog_out[1],),
            "io_current": lambda: (0.0,),
            "encoder0_raw": lambda: (0,),
            "encoder1_raw": lambda: (0,),
            "euromap67_input_bits": lambda: (0,),
            "euromap67_output_bits": lambda: (0,),
            "euromap67_24V_voltage": lambda: (0.0,),
            "euromap67_24V_current": lambda: (0.0,),
            "tool_mode": lambda: (253 if c.robot_mode is RobotMode.RUNNING else c.joint_mode,),
            "tool_analog_input_types": lambda: (0b11,),
            "tool_analog_input0": lambda: (0.0,),
            "tool_analog_input1": lambda: (0.0,),
            "tool_output_voltage": lambda: (io.tool_voltage,),
            "tool_output_current": lambda: (0.0,),
            "tool_temperature": lambda: (_TEMPERATURE,),
            "tool_output_mode": lambda: (0,),
            "tool_digital_output0_mode": lambda: (0,),
            "tool_digital_output1_mode": lambda: (0,),
        }

    def _registers(self) -> dict[str, Getter]:
        """Registers of both directions; 64 of the bits come in two words, the others one by one."""
        registers = self._c.registers
        banks: dict[str, list[int] | list[float] | list[bool]] = {
            "input_int_register_": registers.in_int,
            "output_int_register_": registers.out_int,
            "input_double_register_": registers.in_double,
            "output_double_register_": registers.out_double,
            "input_bit_register_": registers.in_bit,
            "output_bit_register_": registers.out_bit,
        }
        getters: dict[str, Getter] = {}
        for prefix, bank in banks.items():
            for i in range(len(bank)):
                if prefix + str(i) in fields():
                    getters[prefix + str(i)] = _element(bank, i)
        for direction, bits in (("input", registers.in_bit), ("output", registers.out_bit)):
            getters[f"{direction}_bit_registers0_to_31"] = _word(bits, 0)
            getters[f"{direction}_bit_registers32_to_63"] = _word(bits, 32)
        return getters


def _element(bank: Sequence[float], i: int) -> Getter:
    return lambda: (bank[i],)


def _word(bits: Sequence[bool], first: int) -> Getter:
    return lambda: (sum(1 << i for i in range(32) if bits[first + i]),)
