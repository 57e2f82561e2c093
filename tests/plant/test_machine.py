"""Test the loop of the simulated machine."""

from __future__ import annotations

from pathlib import Path

from tests.bus.fake import FakeBus, FakeClock
from tests.plant.bench import Bench, plant_file
from tsa_ctrl.plant.machine import Machine
from tsa_ctrl.plant.settings import load_plant


def test_the_loop_answers_and_lets_time_pass(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.bus.waiting.append((0x601, bytes.fromhex("4000100000000000")))
    begin = bench.clock.now
    bench.machine.run(lambda: bench.clock.now > begin + 0.1)
    assert (0x581, bytes.fromhex("4300100092010200")) in bench.bus.sent
    assert abs(bench.unit.axis.time - 0.1) < 0.01
    assert bench.machine.counts.skipped == 0.0


def test_a_delayed_frame_leaves_at_its_time(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.set_up()
    bench.unit.transmit["drive"].delay = 0.0042
    begin = bench.clock.now
    bench.bus.waiting.append((0x080, b""))
    bench.machine.run(lambda: 0x181 in dict(bench.bus.sent))
    assert 0.004 < bench.clock.now - begin < 0.006


def test_standing_still_for_long_is_not_made_up_for(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.now += 5.0
    bench.machine.tick(bench.clock.now)
    assert bench.machine.counts.skipped > 4.0
    assert bench.unit.axis.time < 0.5


def test_a_sync_on_the_first_bus_alone_does_not_stop_the_timers_of_the_second(tmp_path: Path) -> None:
    buses = "".join(f"[[bus]]\nname = '{name}'\nchannel = '{name}'\n" for name in "ab")
    axes = "".join(f"[[axis]]\nname = '{name}'\nbus = '{name}'\nmotion.kind = 'still'\n" for name in "ab")
    clock = FakeClock()
    first, second = FakeBus(clock), FakeBus(clock)
    machine = Machine(load_plant(plant_file(tmp_path, buses + axes)), first, clock, others=[second])
    machine.start()
    machine.handle(0x602, bytes.fromhex("2b1710000a000000"), clock.now, 1)  # a heartbeat every 10 ms
    before = len(second.sent)
    for _ in range(200):
        clock.now += 5e-4
        machine.step((0x080, b""), clock.now, 0)
    assert [can_id for can_id, _ in second.sent[before:]].count(0x702) in (9, 10, 11)
