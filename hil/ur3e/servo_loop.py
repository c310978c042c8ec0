"""The driver's loop: 500 times a second read the robot, take in orders, send one set-point.

The loop does nothing that can block. Starting and ending the control program, which can, is done
by one worker thread, and while it works no set-point is sent. Whatever goes wrong, the loop lets go
of the arm, says why, and follows nothing until it is deliberately armed with a new epoch.
"""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Callable
from contextlib import suppress

from cell.clock import Clock
from cell.errors import CellError
from hil.real_time import ask_for_real_time
from hil.ur3e.arm_link import PERIOD, ArmLink, Packet
from hil.ur3e.block import Measured, Measurements, Order, Orders, Six
from hil.ur3e.clock_map import ClockMap
from hil.ur3e.conditions import PLAYING, SILENCE, STOPPED, Cause, robot_condition
from hil.ur3e.setpoints import SetPoints

_LATE = 0.5 * PERIOD
_PRIORITY = 3
_LONGEST = 0.03
"""Packets are not held up for longer [s], unless the controller itself is."""
_KICK_CYCLES = 10
_REFUSALS = 10
_LAMP_MASK = 0b111


class ServoLoop:
    """Drives one robot by the orders in shared memory.

    Args:
        link: connected. stop_program: ends a program that `link` cannot end, because it is paused.
        patience: set-points may be overdue, and the arm behind them, for so long [s].
        q_max, qd_max: limits of the joints [rad], [rad/s].
        say: told what people should know.
    """

    def __init__(
        self,
        link: ArmLink,
        orders: Orders,
        measurements: Measurements,
        clock: Clock,
        *,
        patience: float,
        q_max: Six,
        qd_max: Six,
        stop_program: Callable[[], None],
        say: Callable[[str], None],
    ) -> None:
        self._link, self._orders, self._measurements, self._clock = link, orders, measurements, clock
        self._patience, self._stop_program, self._say = patience, stop_program, say
        self._points = SetPoints(q_max, qd_max)
        self._map = ClockMap(_LONGEST)
        self._order, self._order_count = Order(), 0
        self._packet = link.read()
        self._heard = clock.now()
        self._t = self._map.to_wall(self._packet.stamp, self._heard)
        self._armed = self._wanted = self._failed = 0
        self._cause = Cause.NONE
        self._lamp = -1
        self._refused = 0
        self._cycles = self._late = self._lost = self._delayed = 0
        self._worst = 0.0
        self._ended = threading.Event()
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._worker = threading.Thread(target=self._work, name="program", daemon=True)
        self._worker.start()

    def end(self) -> None:
        """Let `run` return, with the arm braked; callable from anywhere."""
        self._ended.set()

    def run(self) -> None:
        """Serve until `end`. A cycle that is missed is skipped, never made up for."""
        ask_for_real_time(_PRIORITY)
        due = self._clock.now()
        while not self._ended.is_set():
            due += PERIOD
            self._clock.sleep_until(due)
            now = self._clock.now()
            delay = now - due
            if delay > _LATE:
                self._late += 1
                self._worst = max(self._worst, delay)
                due += int(delay / PERIOD) * PERIOD
            self.cycle(now)
        self._jobs.put(self._halt)
        self._jobs.put(None)
        self._worker.join(6.0)

    def cycle(self, now: float) -> None:
        """One cycle at `now` [s]."""
        self._cycles += 1
        self._listen(now)
        self._obey(now)
        if self._armed:
            self._drive(now)
        self._report(now)

    # -- the robot ------------------------------------------------------------------------------

    def _listen(self, now: float) -> None:
        try:
            packet = self._link.read()
        except RuntimeError:
            return  # shows as silence
        missed = round((packet.stamp - self._packet.stamp) / PERIOD) - 1
        if packet.stamp == self._packet.stamp:
            self._delayed += now - self._heard > 3 * PERIOD
            return
        if missed > 0 and now - self._heard < 1.5 * PERIOD:
            self._lost += missed
        self._packet, self._heard = packet, now
        self._t = self._map.to_wall(packet.stamp, now)

    def _drive(self, now: float) -> None:
        """Send one set-point, or let go of the arm."""
        cause, why = self._trouble(self._packet, now)
        if cause is Cause.NONE and self._following:
            try:
                taken = self._link.servo(self._points.play(now, PERIOD))
            except RuntimeError as error:
                cause, why = Cause.DISCONNECTED, str(error)
            else:
                # a program that is just ending refuses, too: the next packets tell which it is
                self._refused = 0 if taken else self._refused + 1
                cause = Cause.SERVO if self._refused > _REFUSALS else Cause.NONE
        elif cause is Cause.NONE:
            self._points.played = -math.inf
            if self._cycles % _KICK_CYCLES == 0:
                with suppress(RuntimeError):
                    self._link.kick()
        if cause is not Cause.NONE:
            self._let_go(cause, why)

    @property
    def _following(self) -> bool:
        return self._order.follow == self._armed != 0 and self._points.newest > 0.0

    def _trouble(self, packet: Packet, now: float) -> tuple[Cause, str]:
        if now - self._heard > SILENCE:
            return Cause.DISCONNECTED, ""
        if problem := robot_condition(packet.safety_mode, packet.safety_bits, packet.robot_mode):
            return Cause.ROBOT, problem
        if packet.runtime != PLAYING:
            return Cause.PROGRAM, ""
        if self._following and now - self._points.newest > self._patience:
            return Cause.STARVED, f"the last set-point was due {(now - self._points.newest) * 1e3:.0f} ms ago"
        if self._following and now - self._points.played > self._patience and self._points.played > 0.0:
            return Cause.HELD_UP, f"the arm is {(now - self._points.played) * 1e3:.0f} ms behind"
        return Cause.NONE, ""

    def _let_go(self, cause: Cause, why: str) -> None:
        self._armed, self._cause = 0, cause
        self._points.clear()
        self._jobs.put(self._halt)
        self._say(f"let go of the arm ({cause.name.lower()}){': ' if why else ''}{why}")

    # -- the node -------------------------------------------------------------------------------

    def _obey(self, now: float) -> None:
        found = self._orders.read()
        if found is None or found[0] == self._order_count:
            return
        self._order_count, order = found
        if order.lamp != self._lamp:
            self._lamp = order.lamp
            with suppress(RuntimeError):
                self._link.outputs(order.lamp, _LAMP_MASK)
        if order.arm != self._wanted:
            self._wanted = order.arm
            if self._armed:
                self._let_go(Cause.RELEASED, "")
            if order.arm:
                self._jobs.put(lambda epoch=order.arm: self._arm(epoch))  # type: ignore[misc]
        self._order = order
        if self._armed and order.follow == self._armed:
            problem = self._points.push(order.t, order.q, order.qd, self._packet.q)
            if problem:
                self._let_go(Cause.IMPLAUSIBLE, problem)

    def _report(self, now: float) -> None:
        p = self._packet
        self._measurements.write(
            Measured(
                now, self._t, self._heard, p.stamp, p.q, p.qd, p.effort,
                p.robot_mode, p.safety_mode, p.safety_bits, p.runtime, p.scaling,
                self._armed, self._failed, int(self._cause),
                self._cycles, self._late, self._lost, self._delayed, self._worst,
            )
        )  # fmt: skip

    # -- the worker -----------------------------------------------------------------------------

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except (RuntimeError, CellError) as error:
                self._say(" ".join(str(error).split()))

    def _arm(self, epoch: int) -> None:
        problem = self._link.start()
        if problem or epoch != self._wanted:
            self._failed, self._cause = epoch, Cause.UPLOAD
            self._say(f"not armed: {problem or 'another order came in between'}")
        else:
            self._points.clear()
            self._refused = 0
            self._armed, self._cause = epoch, Cause.NONE

    def _halt(self) -> None:
        """Brake by the control program where it runs, and make sure that it does not go on later."""
        packet = self._packet
        if self._clock.now() - self._heard > SILENCE:
            return  # nothing reaches the controller; its own watchdog ends the program
        fine = not robot_condition(packet.safety_mode, packet.safety_bits, packet.robot_mode)
        if fine and packet.runtime == PLAYING:
            self._link.brake()
        elif packet.runtime != STOPPED:
            self._stop_program()
