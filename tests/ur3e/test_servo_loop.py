"""The driver's loop on a fake controller: follows only when told to, and lets go by name."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import pytest

from cell.config import load
from hil.ur3e.arm_link import PERIOD
from hil.ur3e.block import Measured, Order
from hil.ur3e.conditions import condition
from hil.ur3e.setpoints import CATCH_UP
from tests.ur3e.fakes import HOME, Bench
from tests.wire_helpers import until


def measured(bench: Bench) -> Measured:
    found = bench.measurements.read()
    assert found is not None
    return found


def why(bench: Bench, epoch: int = 1) -> str:
    """The condition as the node would name it."""
    return condition(measured(bench), bench.clock.now(), epoch)


def test_nothing_is_followed_before_it_is_armed_with_the_same_epoch() -> None:
    bench = Bench()
    bench.follow(HOME)
    bench.orders.write(Order(arm=0, follow=1, t=bench.clock.now() + 0.008, q=HOME))
    bench.cycles(5)
    assert bench.link.servos == [] and "not armed" in why(bench)
    bench.arm()
    assert why(bench) == "" and bench.link.servos == []
    bench.follow(HOME, epoch=2)  # also orders another epoch armed
    bench.cycles(1)
    assert bench.link.servos == []


def test_set_points_are_played_at_500_hz_and_end_where_they_end() -> None:
    bench = Bench()
    bench.arm()
    bench.drive(50, speed=0.4)
    end = tuple(x + 0.4 * 0.4 for x in HOME)
    steps = [b[0] - a[0] for a, b in zip(bench.link.servos, bench.link.servos[1:], strict=False)]
    assert len(bench.link.servos) == 200
    assert max(steps) < 1.3 * 0.4 * PERIOD and min(steps) >= 0.0
    for _ in range(10):
        bench.follow(end)  # type: ignore[arg-type]
        bench.cycles(4)
    assert bench.link.packet.q == pytest.approx(end)
    assert why(bench) == "" and bench.said == []


def test_an_armed_arm_without_set_points_is_kept_alive_and_still() -> None:
    bench = Bench()
    bench.arm()
    bench.cycles(100)
    assert bench.link.kicks >= 9 and bench.link.servos == []


def test_set_points_that_stop_coming_brake_the_arm() -> None:
    bench = Bench()
    bench.arm()
    bench.drive(20, speed=0.3)
    sent = len(bench.link.servos)
    bench.cycles(60)
    until(lambda: "brake" in bench.link.calls)
    assert len(bench.link.servos) - sent <= 16  # patience and what was ordered ahead
    bench.cycles()
    assert why(bench).startswith("set-points stopped coming")
    bench.drive(10)  # the node thaws: not followed
    assert len(bench.link.servos) - sent <= 16
    assert any("starved" in text for text in bench.said)


def test_after_missed_cycles_the_arm_catches_up_slowly() -> None:
    """12 ms without the driver: no set-point jumps, and in the end the arm is where it should be.

    The tool's cap holds meanwhile: plans leave more of it than catching up takes.
    """
    assert CATCH_UP * load().motion.speed_margin < 1.0
    bench = Bench()
    bench.arm()
    for k in range(150):
        bench.follow(tuple(x + 0.4 * 0.008 * (k + 1) for x in HOME), (0.4,) * 6)  # type: ignore[arg-type]
        for cycle in range(4):
            if k in (25, 26) and cycle > 0:
                bench.clock.advance()
            else:
                bench.cycles(1)
    steps = [b[0] - a[0] for a, b in zip(bench.link.servos, bench.link.servos[1:], strict=False)]
    assert max(steps) < 1.01 * CATCH_UP * 0.4 * PERIOD and min(steps) >= 0.0
    assert steps[-20:] == pytest.approx([0.4 * PERIOD] * 20, rel=0.02)
    assert why(bench) == ""


def test_a_driver_that_was_held_up_for_long_lets_go() -> None:
    bench = Bench()
    bench.arm()
    bench.drive(25, speed=0.4)
    for _ in range(20):
        bench.clock.advance()
    bench.drive(1, speed=0.4)
    until(lambda: "brake" in bench.link.calls)
    bench.cycles()
    assert why(bench).startswith("driver held up")


FAULTS: list[tuple[str, Callable[[Bench], None], str]] = [
    ("protective stop", lambda b: _packet(b, safety_mode=3, safety_bits=0b100, runtime=1), "protective stop"),
    ("safeguard stop", lambda b: _packet(b, safety_mode=5, safety_bits=0b10000, runtime=4), "safeguard stop"),
    (
        "robot e-stop",
        lambda b: _packet(b, safety_mode=7, safety_bits=0b11000000, robot_mode=3),
        "emergency stop",
    ),
    (
        "system e-stop",
        lambda b: _packet(b, safety_mode=6, safety_bits=0b10100000, robot_mode=3),
        "emergency stop",
    ),
    ("fault", lambda b: _packet(b, safety_mode=9, safety_bits=1 << 9, robot_mode=3), "fault"),
    ("violation", lambda b: _packet(b, safety_mode=8, safety_bits=1 << 8, robot_mode=3), "fault"),
    ("power off", lambda b: _packet(b, robot_mode=3, runtime=1), "robot not running: powered off"),
    ("stopped on the pendant", lambda b: _packet(b, runtime=1), "program stopped"),
    ("paused on the pendant", lambda b: _packet(b, runtime=4), "program stopped"),
    ("a servo refused", lambda b: setattr(b.link, "refuse", True), "servo refused"),
]


def _packet(bench: Bench, **changes: int) -> None:
    bench.link.packet = replace(bench.link.packet, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(("fault", "words"), [f[1:] for f in FAULTS], ids=[f[0] for f in FAULTS])
def test_every_stop_has_a_name_and_ends_only_on_purpose(fault: Callable[[Bench], None], words: str) -> None:
    bench = Bench()
    bench.arm()
    bench.drive(20, speed=0.2)
    healthy = bench.link.packet
    fault(bench)
    bench.drive(4, speed=0.2)
    assert why(bench).startswith(words), why(bench)
    sent = len(bench.link.servos)
    # It goes away by itself, and the node goes on sending: nothing moves.
    bench.link.refuse = False
    bench.link.packet = replace(healthy, q=bench.link.packet.q)
    bench.drive(20, speed=0.2)
    assert len(bench.link.servos) == sent and why(bench) != ""
    bench.link.packet = replace(bench.link.packet, safety_mode=1, safety_bits=1, robot_mode=7, runtime=2)
    bench.arm(2)
    assert why(bench, 2) == ""
    bench.drive(3, epoch=2)
    assert len(bench.link.servos) > sent


def test_a_paused_program_is_ended_so_that_play_cannot_go_on() -> None:
    bench = Bench()
    bench.arm()
    bench.drive(5)
    _packet(bench, runtime=4)
    bench.cycles(2)
    until(lambda: bench.stopped_programs == 1)
    assert "brake" not in bench.link.calls


def test_silence_of_the_robot_is_a_lost_connection() -> None:
    bench = Bench()
    bench.arm()
    for k in range(30):
        bench.follow(HOME)
        bench.cycles(4, packets=False)
        bench.clock.advance(0 if k else 1)
    assert why(bench).startswith("disconnected")
    bench.cycles(5)  # the cable is back
    assert "connection to the robot was lost" in why(bench)
    assert measured(bench).delayed > 20


def test_a_broken_connection_is_no_crash() -> None:
    bench = Bench()
    bench.arm()
    bench.drive(3)
    bench.link.broken = True
    bench.drive(20)
    assert why(bench).startswith("disconnected")
    assert measured(bench).armed == 0


def test_lost_packets_are_counted() -> None:
    bench = Bench()
    bench.cycles(10)
    _packet(bench, stamp=bench.link.packet.stamp + 3 * PERIOD)  # type: ignore[arg-type]
    bench.cycles(1)
    assert measured(bench).lost == 3


def test_an_implausible_set_point_brakes_instead() -> None:
    bench = Bench()
    bench.arm()
    bench.drive(5)
    bench.follow((0.0,) * 6)
    bench.cycles(2)
    assert why(bench).startswith("implausible set-point")
    assert bench.link.packet.q == pytest.approx(HOME)


def test_a_program_that_does_not_start_says_so() -> None:
    bench = Bench()
    bench.link.start_problem = "the payload of 1.1 kg was not taken"
    bench.arm()
    assert measured(bench).failed == 1 and why(bench).startswith("program not started")
    assert bench.said == ["not armed: the payload of 1.1 kg was not taken"]


def test_the_lamp_is_shown_whether_armed_or_not() -> None:
    bench = Bench()
    bench.orders.write(Order(lamp=0b101))
    bench.cycles()
    assert bench.link.lamp == 0b101


def test_measured_times_are_ours_and_even() -> None:
    bench = Bench()
    bench.cycles(20)
    times = []
    for _ in range(20):
        bench.cycles()
        times.append(measured(bench).t)
    assert [b - a for a, b in itertools.pairwise(times)] == pytest.approx([PERIOD] * 19)
    assert abs(times[-1] - bench.clock.now()) <= PERIOD


def test_a_driver_that_fell_silent_is_named() -> None:
    bench = Bench()
    bench.arm()
    assert condition(measured(bench), bench.clock.now() + 0.2, 1).startswith("driver silent")
    assert condition(None, 0.0, 1).startswith("driver silent")


def test_letting_go_on_order_brakes() -> None:
    bench = Bench()
    bench.arm()
    bench.drive(3)
    bench.orders.write(Order(arm=0))
    bench.cycles(2)
    until(lambda: "brake" in bench.link.calls)
    assert "let go" in why(bench)
