"""Short URScript programs: what they do, and what is refused by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.errors import BackendError
from hil.emulator.interfaces import PERIOD
from hil.emulator.programs import recognise
from hil.emulator.urscript.program import ShortProgram
from tests.emulator.fake_robot import HOME, FakeRobot


def run(text: str, robot: FakeRobot | None = None) -> FakeRobot:
    r = robot or FakeRobot()
    r.run(recognise(text, "test:1"))
    r.until(lambda: not r.running)
    r.rest()
    return r


def program(*lines: str) -> str:
    return "def test():\n" + "".join(f"  {line}\n" for line in lines) + "end\n"


def test_outputs_and_registers() -> None:
    r = run(
        program(
            "set_digital_out(1, True)", "set_standard_digital_out(2,True)", "set_digital_out(1, False)",
            "set_configurable_digital_out(0, True) # with set_x()", "set_tool_digital_out(1, True)",
            "set_analog_out(0, 0.25)", "set_analog_outputdomain(1, 0)", "set_analog_out(1, 0.5)",
            "write_output_integer_register(3 + 0, 7)", "write_output_float_register(4, -1.5)",
            "write_output_boolean_register(70, True)", "set_tool_voltage(24)",
        )
    )  # fmt: skip
    assert r.io.digital_out == 1 << 2 | 1 << 8 | 1 << 17
    assert r.io.analog_out == [2.5, 0.012] and r.io.analog_out_type == 1 and r.io.tool_voltage == 24
    assert r.registers.out_int[3] == 7 and r.registers.out_double[4] == -1.5 and r.registers.out_bit[70]


def test_a_bare_line_is_a_program() -> None:
    assert run("set_digital_out(5, True)\n").io.digital_out == 1 << 5
    assert run("stop program\nset_digital_out(5, True)\n").io.digital_out == 1 << 5


def test_settings_texts_and_variables() -> None:
    r = run(
        program(
            "mass = 1.5", "global where = p[0, 0, 0.1, 0, 0, d2r(180)]", "set_payload(mass, [0, 0, 0.05])",
            "set_tcp(where)", "set_gravity([0, 0, 9.5])", 'textmsg("here: ", where[2])',
            'popup("stop # here", title="Note", warning=True, blocking=True)', "halt", "set_payload(9)",
        )
    )  # fmt: skip
    assert r.payload == 1.5 and r.cog.tolist() == [0, 0, 0.05] and r.gravity.tolist() == [0, 0, 9.5]
    assert r.tcp.tolist() == pytest.approx([0, 0, 0.1, 0, 0, np.pi])
    assert r.said == ["3 here: 0.1", "2 Note: stop # here"]


def test_moves_and_their_blends() -> None:
    q1, q2 = HOME + np.array([0.3, 0, 0, 0, 0, 0]), HOME + np.array([0.3, 0.3, 0, 0, 0, 0])
    r = run(program(f"movej({q1.tolist()}, a=2, v=1, r=0.03)", f"movej({q2.tolist()}, a=2, v=1)"))
    assert np.array_equal(r.mover.q, q2)
    inside = np.array(r.qd)[5:-5]
    assert np.abs(inside).max(axis=1).min() > 1e-3  # no stop on the way
    pose = r.mover.kinematics.pose(HOME.tolist(), [0.0] * 6)
    text = ", ".join(map(str, pose))
    run(program(f"movel(p[{text}], 1.0, 0.2)"), r)
    assert r.mover.pose()[:3] == pytest.approx(pose[:3], abs=1e-9)
    run(program(f"movej(get_inverse_kin(p[{text}]), t=1.5)", "sleep(0.1)", "movep(get_actual_tcp_pose())"), r)
    assert r.mover.pose()[:3] == pytest.approx(pose[:3], abs=1e-9)


def test_sleep_takes_its_time_and_speeds_end() -> None:
    r = FakeRobot()
    r.run(recognise(program("sleep(0.5)"), ""))
    assert r.until(lambda: not r.running) == pytest.approx(0.5, abs=2 * PERIOD)
    r = run(program("speedj([0.2, 0, 0, 0, 0, 0], 1.0, 0.5)", "stopj(2.0)"))
    assert r.mover.q[0] - HOME[0] == pytest.approx(0.2 * 0.3 + 0.02 + 0.01, abs=3e-3)
    r = run(program("speedl([0, 0, 0.05, 0, 0, 0], 0.5)", "stopl(1.0)"))
    assert not r.mover.qd.any()


def test_a_custom_function_of_the_control_library() -> None:
    text = (
        "def blink():\n\twrite_output_integer_register(0 +24, 1)\n\tset_standard_digital_out(0, True)\n"
        "\tsleep(0.01)\n\twrite_output_integer_register(0 +24, 2)\nend\n"
    )
    r = FakeRobot()
    r.run(recognise(text, ""))
    r.tick()
    assert r.registers.out_int[24] == 1
    r.tick(10)
    assert r.registers.out_int[24] == 2 and r.io.digital_out == 1 and not r.running


def test_a_secondary_program_is_told_apart() -> None:
    found = recognise("sec tare():\n zero_ftsensor()\nend", "")
    assert isinstance(found, ShortProgram) and found.secondary and found.name == "tare"
    assert not recognise("zero_ftsensor()", "").secondary  # type: ignore[attr-defined]


@pytest.mark.parametrize("line", ["movej([0,0,0,0,0,0])", "sleep(1)", "speedj([0,0,0,0,0,0], 1, 1)"])
def test_a_secondary_program_may_not_move_or_wait(line: str) -> None:
    with pytest.raises(BackendError, match="the secondary program 'tare' may not call"):
        recognise(f"sec tare():\n set_digital_out(1, True)\n {line}\nend", "")


def test_protective_stop() -> None:
    r = run(program("protective_stop()", "set_digital_out(0, True)"))
    assert r.stops and r.io.digital_out == 0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ("def x():\n  sleep(1)\n", "does not close with 'end'"),
        (program("open_the_door(1)"), r"open_the_door\(\) cannot be run"),
        (program("x = socket_open(1)"), r"socket_open\(\) cannot be run"),
        (program("while True:", "sync()", "end"), "'while'.*control flow"),
        (program("thread t():", "end"), "'thread'"),
        (program("set_digital_out(1)"), r"set_digital_out\(\): missing a required argument: 'b'"),
        (program("movej([0,0,0,0,0,0], speed=2)"), r"movej\(\): got an unexpected keyword argument 'speed'"),
        (program("movej([0,0"), "cannot read"),
        (program("3 + 4"), "does nothing"),
        (program("robot.move()"), "cannot call 'robot.move'"),
        (program("__import__('os')"), "cannot be run"),
        ("hello there", "cannot read 'hello there'"),
    ],
)
def test_what_cannot_be_run_is_refused_by_name(text: str, says: str) -> None:
    with pytest.raises(BackendError, match=says):
        recognise(text, "test:1")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("set_digital_out(9, True)", "0..7"),
        ("movej([0, 0, 0], v=1)", "6 numbers"),
        ("set_payload(x)", "'x' is not set"),
        ("set_payload(1/0)", "division"),
        ("stopj(0)", "above 0"),
        ("set_tool_voltage(5)", "0, 12, 24"),
        ("movej(p[3, 0, 0, 0, 0, 0])", "out of reach"),
        ("set_analog_out(0, 2)", "0..1"),
        ("force_mode(p[0,0,0,0,0,0], [1,0,0,0,0,0], [0,0,0,0,0,0], 1, [1,1,1,1,1,1])", "only type 2"),
        ("set_payload([1] and 3)", "not supported"),
        ("set_payload(1e400)", "number"),
    ],
)
def test_arguments_that_make_no_sense_end_the_program(line: str, says: str) -> None:
    r = FakeRobot()
    r.run(recognise(program(line), ""))
    with pytest.raises(BackendError, match=says):
        r.tick(5)


@given(st.text(max_size=80))
@settings(max_examples=150, deadline=None)
def test_any_text_is_run_or_refused_in_a_sentence(text: str) -> None:
    for script in (text, program(text), f"def rtde_control():\n{text}", f'"reverse_socket"\n{text}'):
        try:
            recognise(script, "test:1")
        except BackendError as error:
            assert str(error)
