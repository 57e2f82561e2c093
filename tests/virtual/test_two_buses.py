"""Test two buses in one daemon: one cycle over both, and the effect of a fault on the axes of the other."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.virtual.files import Tables, controller, merged, plant, write
from tsa_ctrl import simulate_loop
from tsa_ctrl.config import load_configuration
from tsa_ctrl.errors import UsageError

FAULT = 0.8  # s
BUSES = [{"name": "left", "channel": "can0"}, {"name": "right", "channel": "can1"}]
NAMES = ("knee", "hip", "ankle", "toe")


def on_buses(tables: Tables, places: Mapping[str, str], buses: list[dict[str, Any]] | None = None) -> Tables:
    """Return the tables with one axis for each name in `places`, on that bus, with unique node ids."""
    (first,) = tables["axis"]
    axes = [
        merged(
            first,
            {
                "name": name,
                "bus": place,
                "drive": {"node_id": 1 + number, "serial_number": 1 + number},
                "encoder": {"node_id": 32 + number},
                "torque_sensor": {"node_id": 64 + number},
            },
        )
        for number, (name, place) in enumerate(places.items())
    ]
    return tables | {"bus": BUSES if buses is None else buses, "axis": axes}


TWO = {"knee": "left", "hip": "right"}


def files(folder: Path, places: Mapping[str, str] = TWO, **axis: Any) -> tuple[Path, Path]:
    still = {"joint": {"load": "held"}}
    tables = controller(**axis)
    return write(folder, on_buses(tables, places), on_buses(plant(**still), places))


def test_one_cycle_runs_over_both_buses(tmp_path: Path) -> None:
    """Both axes have torque, every answer arrives, and the error of each axis is as small as on one bus."""
    result = simulate_loop(*files(tmp_path), 3.0)
    assert result.summary.bus == "can0, can1"
    assert not any(event.fault for event in result.summary.events)
    assert not any(node.missed or node.late or node.repeated for node in result.summary.nodes)
    (tmp_path / "alone").mkdir()
    alone = simulate_loop(*write(tmp_path / "alone", controller(), plant(joint={"load": "held"})), 3.0)
    for axis in result.axes:
        assert axis.to_dict()["rms"] == pytest.approx(alone.axes[0].to_dict()["rms"], rel=0.1)


def test_four_axes_that_one_bus_cannot_carry_run_on_two_at_1_khz(tmp_path: Path) -> None:
    """Each bus has two lean drives with encoders, as in a leg."""
    places = {"knee": "left", "hip": "left", "ankle": "right", "toe": "right"}
    axis = {"drive": {"pdo": "lean"}, "torque_sensor": None}
    tables = controller(file={"controller": {"rate": 1000.0}}, **axis)
    for each in (tables := on_buses(tables, places))["axis"]:
        del each["torque_sensor"]
    result = simulate_loop(*write(tmp_path, tables, on_buses(plant(joint={"load": "held"}), places)), 2.0)
    assert result.summary.sent == result.summary.planned
    assert result.summary.skipped == 0
    assert not any(node.missed for node in result.summary.nodes)
    assert len(result.axes) == 4
    one = tables | {"bus": {"channel": "can0"}, "axis": [merged(each, {"bus": None}) for each in tables["axis"]]}
    with pytest.raises(UsageError, match="1000 Hz with 4 axes needs"):
        load_configuration(write(tmp_path, one)[0])


@pytest.mark.parametrize("fault", ["emcy axis=knee", "interface_down axis=knee", "heartbeat_lost axis=knee"])
def test_a_fault_on_one_bus_ramps_the_axes_of_the_other_down(tmp_path: Path, fault: str) -> None:
    """The axis on the healthy bus has no fault, ramps down without a step, and its drive confirms that it is off."""
    axis = {"setpoint": {"kind": "constant", "offset": 0.5}, "drive": {"rpdo_timeout": 0.5}}
    result = simulate_loop(*files(tmp_path, **axis), 2.0, faults=[f"{fault}@{FAULT}"])
    first, other = result.axes
    begin = next(event.t for event in result.summary.events if event.fault)
    assert begin == pytest.approx(FAULT, abs=0.25)
    assert first.faults
    assert not other.faults
    time, torque = other.truth["clock"] - other.start, np.abs(other.truth["tau_m"])
    ramp = (time > begin + 0.01) & (time < begin + 0.28)
    assert (np.abs(np.diff(torque[ramp])) < 0.02).all()
    assert (torque[(time > begin + 0.14) & (time < begin + 0.16)] > 0.1).all()
    assert torque[-1] < 0.01
    assert all("knee" in line for line in result.summary.unconfirmed)
    assert bool(result.summary.unconfirmed) is ("interface" in fault)
    assert other.truth["enabled"][-1] == 0.0


def test_the_plant_may_list_its_buses_in_another_order(tmp_path: Path) -> None:
    tables = on_buses(plant(joint={"load": "held"}), {"knee": "b", "hip": "a"})
    tables["bus"] = [{"name": "a", "channel": "can1"}, {"name": "b", "channel": "can0"}]
    result = simulate_loop(*write(tmp_path, on_buses(controller(), TWO), tables), 0.5)
    assert not any(event.fault for event in result.summary.events)
    tables["bus"][0]["channel"] = "can7"
    with pytest.raises(UsageError, match="write the same channels in both files"):
        simulate_loop(*write(tmp_path, on_buses(controller(), TWO), tables), 0.5)


def test_a_name_that_means_another_drive_in_the_plant_is_one_line(tmp_path: Path) -> None:
    """The plant numbers its nodes by the order of its axes. The hip's controller would drive the knee."""
    still = on_buses(plant(joint={"load": "held"}), TWO)
    for axis, name in zip(still["axis"], reversed(TWO), strict=True):
        axis["name"] = name
    with pytest.raises(UsageError, match=r"'knee' .* has drive node 1, which belongs to axis 'hip' of the plant"):
        simulate_loop(*write(tmp_path, on_buses(controller(), TWO), still), 0.5)


def changed(number: int, **keys: Any) -> list[dict[str, Any]]:
    return [each | keys if place == number else each for place, each in enumerate(BUSES)]


@pytest.mark.parametrize(
    ("buses", "places", "line"),
    [
        (changed(1, rate=500), TWO, r"\[\[bus\]\] rate 500: one cycle runs over all buses at \[controller\] rate"),
        (changed(1, name="left"), {"knee": "left", "hip": "left"}, "2 buses have the name 'left'"),
        (changed(1, name=""), TWO, r"\[\[bus\]\] number 2 has no name|number 2: name"),
        (BUSES, {"knee": "left", "hip": "left"}, r"\[\[bus\]\] 'right': no axis uses it"),
        (BUSES, {"knee": "left", "hip": "middle"}, "axis 'hip': there is no bus 'middle'; choose one of left, right"),
        (changed(1, channel="can0"), TWO, "channel 'can0' is also used by 'left'"),
        (changed(1, host_node_id=126), TWO, r"'right': host_node_id differs from bus 'left'"),
        (changed(1, supervision={"tolerated_misses": 5}), TWO, "supervision differs from bus 'left'"),
        (changed(1, bitrate=100), TWO, r"bus 'right': bitrate"),
        ([], TWO, "bus is a list without tables"),
    ],
)
def test_what_cannot_run_in_one_cycle_is_one_line(
    tmp_path: Path, buses: list[dict[str, Any]], places: dict[str, str], line: str
) -> None:
    with pytest.raises(UsageError, match=line) as error:
        load_configuration(write(tmp_path, on_buses(controller(), places, buses))[0])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("axes", "changes", "line"),
    [
        (TWO, {"bus": None}, "axis 'hip': bus is missing; set it to one of left, right"),
        (TWO, {"encoder": {"node_id": 32}}, "axis 'hip' on bus 'right': node_id 32 is also used by axis 'knee' on bus"),
        ({}, {"bus": "left"}, r"axis 'knee': bus 'left', but \[bus\] has no name"),
    ],
)
def test_axes_name_their_bus_if_there_are_several_and_nodes_are_unique(
    tmp_path: Path, axes: dict[str, str], changes: dict[str, Any], line: str
) -> None:
    tables = on_buses(controller(), axes) if axes else controller()
    tables["axis"][-1] = merged(tables["axis"][-1], changes)
    with pytest.raises(UsageError, match=line):
        load_configuration(write(tmp_path, tables)[0])


def test_a_full_bus_is_named_and_each_bus_has_its_own_load(tmp_path: Path) -> None:
    places = {"knee": "left", "hip": "left", "ankle": "right"}
    buses = [{**each, "bitrate": 500_000} for each in BUSES]
    tables = on_buses(controller(file={"controller": {"rate": 500.0}}), places, buses)
    with pytest.raises(UsageError, match=r"\[\[bus\]\] 'left' bitrate 500000: 500 Hz with 2 axes needs") as error:
        load_configuration(write(tmp_path, tables)[0])
    assert "in [[bus]] 'left' and in every node" in str(error.value)
    tables["axis"][0]["bus"] = "right"
    loads = load_configuration(write(tmp_path, tables | {"bus": [buses[0], BUSES[1]]})[0]).loads
    assert [load.bitrate for load in loads] == [500_000, 1_000_000]


def test_a_single_bus_may_be_a_list_and_may_have_a_name(tmp_path: Path) -> None:
    for bus in ({"channel": "can3"}, [{"channel": "can3"}], [{"channel": "can3", "name": "left"}]):
        tables = controller(file={"bus": bus})
        assert load_configuration(write(tmp_path, tables)[0]).file.bus.channel == "can3"
