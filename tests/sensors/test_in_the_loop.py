"""Test serial sensors in the loop: configuration, values in cycle and log, and their health as events."""

from __future__ import annotations

import math
import time
from contextlib import closing
from pathlib import Path

import pytest

from tests.daemon.machine import Machine
from tests.sensors.lines import Line, wait_for
from tsa_ctrl.config import load_configuration
from tsa_ctrl.control.estimator import EstimateState
from tsa_ctrl.control.temperature import Temperature
from tsa_ctrl.daemon.notices import AxisSensors, Events
from tsa_ctrl.errors import UsageError
from tsa_ctrl.model.feedforward import Feedforward

CONFIG = Path(__file__).resolve().parents[2] / "config"


def controller(folder: Path, serial: str, can_sensor: bool = False, estimator: str = "fixed") -> Path:
    """Return the example configuration with these serial sensors, and optionally the joint torque sensor on CAN."""
    (folder / "actuator.toml").write_text((CONFIG / "actuator.toml").read_text())
    text = (CONFIG / "controller.toml").read_text()
    if not can_sensor:
        begin, end = text.index("[axis.torque_sensor]"), text.index("[axis.setpoint]")
        text = text[:begin] + text[end:]
    text = text.replace('# kind = "sensor" ', f'kind = "{estimator}" ', 1)
    path = folder / "controller.toml"
    path.write_text(text + serial)
    return path


def sensor(quantity: str, port: str, more: str = "") -> str:
    return f'\n[[axis.serial]]\nquantity = "{quantity}"\nport = "{port}"\n{more}\n'


@pytest.mark.parametrize(
    ("serial", "can_sensor", "said"),
    [
        (sensor("tau_j", "/dev/a"), True, "tau_j already has a sensor"),
        (sensor("t1", "/dev/a") + sensor("t1", "/dev/b"), False, "t1 already has a sensor"),
        (sensor("t1", "/dev/a") + sensor("t3", "/dev/a"), False, "already read by another sensor"),
        (sensor("t1", "/dev/a", "timeout = 0.001"), False, "shorter than the time between two values"),
    ],
)
def test_a_contradiction_is_said_before_anything_moves(
    tmp_path: Path, serial: str, can_sensor: bool, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        load_configuration(controller(tmp_path, serial, can_sensor))


def test_the_log_and_the_estimator_take_the_serial_values(tmp_path: Path) -> None:
    seen: list[float] = []
    with closing(Machine(tmp_path)) as machine:
        machine.axis.instruments.connect(
            {"tau_j": lambda now: 0.25, "t1": lambda now: 40.0, "t3": lambda now: math.nan}
        )
        update = machine.axis.estimator.update
        machine.axis.estimator.update = lambda sample: (seen.append(sample.tau_j), update(sample))[1]  # type: ignore[assignment]
        machine.run(seconds=0.3)
        records = machine.records()
        assert set(records["tau_j"]) == {0.25}
        assert set(records["t1"]) == {40.0}
        assert all(math.isnan(value) for value in records["t3"])
        assert set(seen) == {0.25}


MAP = (('# kind = "sensor"  ', 'kind = "map"  '), ('# source = "fixed"  ', 'source = "sensor"  '))
THETA = "Sensors on serial lines that send"  # heading of the example's section


def test_the_map_follows_a_measured_bending_and_freezes_without_one(tmp_path: Path) -> None:
    port = sensor("theta", "/dev/nothing", "scale = 0.0174532925")
    still = ("amplitude = 0.5", "amplitude = 0.0")  # the motor in this test is at rest, so no torque may act on it
    with closing(Machine(tmp_path, *MAP, still, (f"# {THETA}", f"{port}\n# {THETA}"))) as machine:
        model, says = machine.axis.model, [1.2]
        machine.axis.instruments.connect({"theta": lambda now: says[0] * model.bending_angle})
        lost = 800
        machine.drive.at_sync[lost] = lambda: says.__setitem__(0, math.nan)
        machine.run(seconds=1.2)
        records = machine.records()
        assert records["theta"][lost - 50] == pytest.approx(1.2 * model.bending_angle)
        assert math.isnan(records["theta"][lost + 50])
        for row in (lost - 50, lost + 50):
            assert records["friction_angle"][row] == pytest.approx(1.2 * model.friction_angle)
        states = [records["estimate_state"][row] for row in (lost - 50, lost + 50)]
        assert states == [EstimateState.ESTIMATED.value, EstimateState.INVALID.value]


@pytest.mark.parametrize(
    ("estimator", "default", "source", "serial"),
    [
        ("map", "fixed", "sensor", ""),
        ("map", "fixed", "command", sensor("theta", "/dev/a")),
        ("fixed", "none", "serial", ""),
        ("fixed", "none", "none", sensor("temperature", "/dev/a")),
    ],
)
def test_a_source_of_bending_or_temperature_and_its_sensor_belong_together(
    tmp_path: Path, estimator: str, default: str, source: str, serial: str
) -> None:
    path = controller(tmp_path, serial, estimator=estimator)
    path.write_text(path.read_text().replace(f'# source = "{default}" ', f'source = "{source}" ', 1))
    with pytest.raises(UsageError, match="belong together"):
        load_configuration(path)


def test_the_state_of_a_line_is_told_once(tmp_path: Path) -> None:
    line = Line(tmp_path / "tty")
    axes = load_configuration(controller(tmp_path, sensor("t1", str(line.path), "rate = 20\ntimeout = 0.2"))).file.axes
    events = Events()
    sensors = AxisSensors(axes)
    try:
        assert sensors.sources("hip") == {}
        read = sensors.sources("knee")["t1"]

        def told(text: str) -> bool:
            sensors.check(0.0, events)
            return any(text in event.text for event in events.all)

        wait_for(lambda: told("values come"), lambda: line.send(b"41.5\n"))
        wait_for(lambda: read(time.monotonic()) == 41.5, lambda: line.send(b"41.5\n"))
        line.unplug()
        wait_for(lambda: told("was unplugged"))
        assert [event.axis for event in events.all] == ["knee"] * len(events.all)
        assert sum("was unplugged" in event.text for event in events.all) == 1
    finally:
        sensors.close()


def test_the_law_follows_a_measured_temperature_slowly(tmp_path: Path) -> None:
    """Friction grows by 1 %/K. After a jump of 10 K it changes at 2 K/s, and without a reading it stays constant."""
    port = sensor("temperature", "/dev/nothing")
    still = ("amplitude = 0.5", "amplitude = 0.0")
    warm = ('# source = "none"  ', 'source = "serial"  ')
    with closing(Machine(tmp_path, still, warm, (f"# {THETA}", f"{port}\n# {THETA}"))) as machine:
        effects = {"thermal_friction_drift": {"temperature_coefficient": 0.01, "reference_temperature": 25.0}}
        model = machine.axis.model.with_effects(effects)
        inverse = Feedforward(model, 1e-3, {"q_j", "q_m", "temperature"})
        machine.axis.law._inverse = inverse
        says = [25.0]
        machine.axis.instruments.connect({"temperature": lambda now: says[0]})
        found: dict[int, float] = {}
        for cycle, reading in ((400, 35.0), (900, math.nan), (1100, math.nan)):

            def change(cycle: int = cycle, reading: float = reading) -> None:
                found[cycle] = inverse.friction_angle
                says[0] = reading

            machine.drive.at_sync[cycle] = change
        machine.run(seconds=1.3)
    x = model.friction_angle
    assert found[400] == pytest.approx(x)
    assert found[900] == pytest.approx(1.01 * x, rel=1e-3)
    assert found[1100] == pytest.approx(found[900], rel=1e-4)


@pytest.mark.parametrize("reading", [math.nan, math.inf, -273.0, 900.0])
def test_a_broken_temperature_sensor_changes_nothing(reading: float) -> None:
    temperature = Temperature(1e-3)
    assert math.isnan(temperature.update(reading))
    assert temperature.update(30.0) == 30.0
    assert temperature.update(reading) == 30.0
