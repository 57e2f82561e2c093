"""`tsa init` writes files that are good as they are, and nothing over what is there."""

from __future__ import annotations

from pathlib import Path

import pytest

from tsa_ctrl.cli import main
from tsa_ctrl.cli.init import DESK, SHIPPED, with_values
from tsa_ctrl.config import check_drives, load_configuration
from tsa_ctrl.plant.process import check


def run(*line: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(line))
    return int(ended.value.code or 0)


@pytest.mark.parametrize("options", [[], ["--desk"]])
def test_what_is_written_is_valid(options: list[str], tmp_path: Path) -> None:
    assert run("init", *options, str(tmp_path / "new")) == 0
    check_drives(load_configuration(tmp_path / "new/controller.toml"))
    assert len(check(tmp_path / "new/plant.toml").axis) == 1


def test_the_desk_set_has_a_bus_and_rights_that_any_machine_has(tmp_path: Path) -> None:
    run("init", "--desk", str(tmp_path / "new"))
    file = load_configuration(tmp_path / "new/controller.toml").file
    plant = check(tmp_path / "new/plant.toml")
    assert (file.bus.interface, file.bus.channel) == (plant.bus.interface, plant.bus.channel)
    assert (file.bus.interface, file.realtime.allow_without, file.controller.rate) == ("udp_multicast", True, 250.0)


def test_nothing_that_is_there_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plant.toml").write_text("mine")
    assert run("init", str(tmp_path)) == 2
    assert "plant.toml: is there already" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plant.toml"]
    assert (tmp_path / "plant.toml").read_text() == "mine"


@pytest.mark.parametrize("name", DESK)
def test_every_key_that_the_desk_changes_stands_in_the_shipped_file(name: str) -> None:
    text = (SHIPPED / name).read_text(encoding="utf-8")
    before, after = text.splitlines(), with_values(text, DESK[name]).splitlines()
    assert len(before) == len(after)

    with pytest.raises(KeyError):
        with_values(text, {"bus": {"no_such_key": "1"}})
