"""Modes, permit and cap: a request alone is never enough, and what is lost is lost at once."""

from __future__ import annotations

import math
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.config import CellConfig, load
from cell.decision.modes import NOBODY, ModeState, Permit, PermitKeeper, Sensed, decide
from cell.motion.ssm import allowed_speed, protective_separation
from cell.wire.vocabulary import SIGNALS, Mode, RobotType

CAMERA = 0.1
INDUSTRIAL, COLLABORATIVE = RobotType.INDUSTRIAL, RobotType.COLLABORATIVE


@cache
def config() -> CellConfig:
    return load()


def keeper_after(seconds: float, sensed: Sensed) -> tuple[PermitKeeper, Permit, float]:
    """A keeper that saw the same for a while, its permit, and the time."""
    keeper, t = PermitKeeper(config()), 0.0
    permit = keeper.update(t, sensed)
    while t < seconds:
        t += CAMERA
        permit = keeper.update(t, sensed)
    return keeper, permit, t


# -- the speed that a separation allows ---------------------------------------------------------------


@given(st.floats(0.0, 3.0))
def test_the_allowed_speed_is_the_inverse_of_the_protective_separation(v: float) -> None:
    c = config().separation
    assert allowed_speed(protective_separation(v, c), c) == pytest.approx(v, abs=1e-9)


def test_the_worked_example_of_the_standard() -> None:
    """S_p = 1.6 (0.1 + 0.5/2.5) + 0.5 0.1 + 0.5^2 / 5 + 0.1 + 0.05 + 0.005 = 0.735 m."""
    import msgspec

    c = msgspec.structs.replace(
        config().separation, human_speed=1.6, reaction_time=0.1, deceleration=2.5, intrusion=0.1,
        sensor_error=0.05, robot_error=0.005,
    )  # fmt: skip
    assert protective_separation(0.5, c) == pytest.approx(0.735, abs=1e-9)


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_farther_never_means_slower(a: float, b: float) -> None:
    c = config().separation
    assert allowed_speed(max(a, b), c) >= allowed_speed(min(a, b), c) >= 0.0


def test_nobody_in_sight_allows_everything() -> None:
    assert allowed_speed(math.inf, config().separation) == math.inf


# -- the permit ---------------------------------------------------------------------------------------


def test_industrial_mode_is_permitted_after_a_while_of_clear_sight() -> None:
    clear = Sensed(1.4, 0.05)
    assert not keeper_after(config().separation.permit_hold - CAMERA, clear)[1].industrial
    assert keeper_after(config().separation.permit_hold + CAMERA, clear)[1].industrial


@pytest.mark.parametrize(
    "lost",
    [
        Sensed(0.3, 0.05),
        Sensed(1.4, 1.0),
        Sensed(1.4, math.inf),
        Sensed(math.inf, 0.05, "the person camera is blocked"),
        Sensed(1.4, 0.05, sign_up=True),
    ],
    ids=["near", "stale", "never", "blocked", "thumb up"],
)
def test_the_permit_is_lost_at_once(lost: Sensed) -> None:
    keeper, permit, t = keeper_after(2.0, Sensed(1.4, 0.05))
    assert permit.industrial
    after = keeper.update(t + 0.04, lost)
    assert not after.industrial and after.reason


@pytest.mark.parametrize(
    "lost", [Sensed(1.4, 1.0), Sensed(math.inf, 0.05, "blocked")], ids=["stale", "blocked"]
)
def test_without_a_usable_camera_a_person_is_assumed(lost: Sensed) -> None:
    keeper, permit, t = keeper_after(2.0, Sensed(1.4, 0.05))
    assert permit.cap > 0.8
    assert keeper.update(t + 0.04, lost).cap == config().motion.collaborative_speed


def test_the_cap_falls_at_once_and_rises_slowly() -> None:
    keeper, permit, t = keeper_after(2.0, Sensed(1.4, 0.05))
    assert permit.cap == pytest.approx(allowed_speed(1.4, config().separation))
    near = keeper.update(t + 0.1, Sensed(1.0, 0.05)).cap
    assert near == pytest.approx(allowed_speed(1.0, config().separation))
    assert keeper.update(t + 0.2, Sensed(1.4, 0.05)).cap == near
    assert keeper.update(t + 0.6, Sensed(1.4, 0.05)).cap == pytest.approx(permit.cap)


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 0.6), st.booleans()), min_size=1, max_size=30))
def test_the_cap_never_exceeds_what_the_last_measurement_allows(
    steps: list[tuple[float, float, bool]],
) -> None:
    keeper, floor = PermitKeeper(config()), config().motion.collaborative_speed
    for k, (d, age, blocked) in enumerate(steps):
        sensed = Sensed(d, age, "blocked" if blocked else "")
        permit = keeper.update(0.04 * k, sensed)
        blind = blocked or age > config().separation.max_age
        most = floor if blind else max(floor, allowed_speed(d, config().separation))
        assert floor <= permit.cap <= most + 0.01 + 1e-9


# -- the mode -----------------------------------------------------------------------------------------


def mode(own: RobotType, permit: Permit, stopped: bool = False, waiting: bool = False) -> ModeState:
    return decide(config().motion, own, permit, stopped, waiting)


def test_a_request_without_a_permit_stays_collaborative() -> None:
    """A gesture alone, with the person close by, never gives industrial speed."""
    near = Permit(False, 0.3, config().motion.collaborative_speed, "a person is 0.30 m away")
    state = mode(INDUSTRIAL, near)
    assert (state.mode, state.requested, state.permitted) == (Mode.COLLABORATIVE, True, False)
    assert state.cap == config().motion.collaborative_speed


def test_a_permit_without_a_request_stays_collaborative() -> None:
    assert mode(COLLABORATIVE, NOBODY).mode is Mode.COLLABORATIVE
    assert mode(COLLABORATIVE, NOBODY).cap == config().motion.collaborative_speed


def test_both_give_industrial_mode_and_the_least_cap_binds() -> None:
    free = mode(INDUSTRIAL, NOBODY)
    assert (free.mode, free.cap, free.binding) == (
        Mode.INDUSTRIAL,
        config().motion.industrial_speed,
        "industrial",
    )
    person = mode(INDUSTRIAL, Permit(True, 1.2, 0.8))
    assert (person.mode, person.cap, person.binding) == (Mode.INDUSTRIAL, 0.8, "separation")


def test_a_stop_overrides_everything_and_a_wait_shows() -> None:
    assert (mode(INDUSTRIAL, NOBODY, stopped=True).mode, mode(INDUSTRIAL, NOBODY, stopped=True).cap) == (
        Mode.STOPPED,
        0.0,
    )
    assert mode(COLLABORATIVE, NOBODY, waiting=True).mode is Mode.HOLD


def test_the_light_says_what_the_robot_has_understood() -> None:
    near = Permit(False, 0.3, 0.25)
    assert mode(COLLABORATIVE, near).signal(0.1) == "collaborative"
    assert mode(COLLABORATIVE, near).signal(0.9) == "requested"
    assert mode(INDUSTRIAL, NOBODY).signal(0.9) == "industrial"
    assert mode(INDUSTRIAL, NOBODY, stopped=True).signal(0.9) == "stopped"
    assert mode(COLLABORATIVE, near, waiting=True).signal(0.1) == "hold"
    assert {"collaborative", "requested", "industrial", "stopped", "hold"} <= set(SIGNALS)
