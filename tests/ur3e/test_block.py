"""Shared memory between node and driver: what is read is whole, whoever dies when."""

from __future__ import annotations

import math
import mmap
import os
import subprocess
import sys

from hypothesis import given
from hypothesis import strategies as st

from cell.clock import perf_s
from hil.ur3e.block import (
    MEASURED,
    ORDER,
    Block,
    Measured,
    Measurements,
    Order,
    Orders,
    attach,
    shared_memory,
)

numbers = st.floats(allow_nan=False)
six = st.tuples(*[numbers] * 6)
small = st.integers(0, 2**32 - 1)
signed = st.integers(-(2**31), 2**31 - 1)
long = st.integers(0, 2**53)


def own_memory() -> mmap.mmap:
    descriptor, memory = shared_memory()
    os.close(descriptor)
    return memory


@given(st.builds(Order, small, small, small, numbers, six, six))
def test_orders_arrive_as_they_were_sent(order: Order) -> None:
    memory = own_memory()
    orders = Orders(memory)
    assert orders.read() is None
    orders.write(order)
    assert orders.read() == (1, order)
    orders.write(Order())
    assert orders.read() == (2, Order())


@given(
    st.builds(
        Measured, numbers, numbers, numbers, numbers, six, six, six, signed, signed, small, signed, numbers,
        small, small, small, long, long, long, long, numbers,
    )
)  # fmt: skip
def test_measurements_arrive_as_they_were_sent(measured: Measured) -> None:
    memory = own_memory()
    Measurements(memory).write(measured)
    assert Measurements(memory).read() == measured


def test_both_blocks_share_the_memory_without_touching_each_other() -> None:
    descriptor, memory = shared_memory()
    other = attach(descriptor)
    os.close(descriptor)
    for k in range(5):
        Orders(memory).write(Order(arm=k))
    Measurements(other).write(Measured(robot_mode=-1))
    found = Orders(other).read()
    assert found is not None
    measured = Measurements(memory).read()
    assert measured is not None and measured.robot_mode == -1


@given(st.integers(0, Block.size(ORDER) - 1), st.integers(1, 255))
def test_a_torn_slot_is_never_read(at: int, flip: int) -> None:
    """Whatever byte is wrong, the reader gets one of the two whole values or the other slot's."""
    memory = own_memory()
    orders = Orders(memory)
    first, second = Order(arm=1, q=(1.0,) * 6), Order(arm=2, q=(2.0,) * 6)
    orders.write(first)
    orders.write(second)
    memory[at] = memory[at] ^ flip
    assert orders.read() in ((1, first), (2, second))


def test_a_reader_beside_a_hasty_writer_sees_whole_values_only() -> None:
    descriptor, memory = shared_memory()
    orders = Orders(memory)
    code = (
        "import sys, mmap; from hil.ur3e.block import *; m = attach(int(sys.argv[1])); o = Orders(m)\n"
        "for k in range(10**9): o.write(Order(k % 2**32, 0, 0, float(k), (float(k),) * 6, (float(-k),) * 6))"
    )
    writer = subprocess.Popen([sys.executable, "-c", code, str(descriptor)], pass_fds=[descriptor])
    try:
        seen, last, end, patience = 0, 0, math.inf, perf_s() + 20.0
        while perf_s() < min(end, patience):
            found = orders.read()
            if found is None:
                continue
            if not seen:
                end = perf_s() + 0.5
            count, order = found
            assert set(order.q) == {order.t} and set(order.qd) == {-order.t}
            assert count >= last
            seen, last = seen + 1, count
        assert seen > 100 and last > 100
    finally:
        writer.kill()
        writer.wait()
        os.close(descriptor)


def test_layouts_have_no_holes_that_differ_between_machines() -> None:
    assert ORDER.format.startswith("<") and MEASURED.format.startswith("<")
