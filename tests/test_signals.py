"""One row in the table of signals adds a signal to the log, the status, the client and all displays."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT
from tsa_ctrl.signals import FIELD_NAMES

# Public interfaces: the columns of a log in order, and the fields of an axis in the status and in a measurement.
LOG = """
t tau_m tau_j omega_j q_j q_m omega_m theta t1 t3 temperature tau_j_des tau_m_cmd cycle lateness work pdo_age missed
state sigma friction_term friction_angle pretension estimate_state limit_reason tau_j_stretch tau_j_stretch_low
tau_j_stretch_high tau_j_model tau_j_model_low tau_j_model_high
"""
STATUS = """
name t tau_j_des tau_m_cmd tau_m tau_j omega_j q_j q_m omega_m sigma friction_term friction_angle pretension
estimate_state state limit_reason missed pdo_age late repeated malformed tau_j_stretch tau_j_model guard_latched
estimator ages set_point_limit parameters guard_energy guard_back_off guard_count compensation_limit_share
compensation_limit_credit compensation_limit_capacity compensation_limit_withdrawn compensation_limit_contradicted
guard compensation_limit
"""
CLIENT = """
name tau_j_des tau_m_cmd tau_m tau_j tau_j_stretch tau_j_model q_j omega_j q_m omega_m permitted limit_reason
set_point_limit clamped
"""
ROW = """
    Signal("follow_rate", "N*m/s", "rate of the set-point", _LOG | _STATUS | _CLIENT, "set_point.rate", chart="rate"),
"""
RUN = """
import json, sys
from pathlib import Path
from types import ModuleType

signals = ModuleType("tsa_ctrl.signals")
sys.modules[signals.__name__] = signals  # before any other module of the package reads the table
exec(compile(Path(sys.argv[1]).read_text(), sys.argv[1], "exec"), signals.__dict__)

from tests.virtual.files import controller, plant, write
from tests.virtual.serving import ServedRun
from tools.manual.parts import signals as manual_table
from tsa_ctrl.dashboard.server import signals_shown
from tsa_ctrl.ipc.client import Client
from tsa_ctrl.ipc.page import SHOWN
from tsa_ctrl.ipc.protocol import Status
from tsa_ctrl.live import foxglove_layout, plotjuggler_layout
from tsa_ctrl.live import schema_of
from tsa_ctrl.log.convert import convert
from tsa_ctrl.signals import Place

folder, found = Path(sys.argv[2]), {}
files = write(folder, controller(file={"socket": {"path": str(folder / "s")}}), plant())
run = ServedRun(*files, seconds=0.6, out=folder / "out")


def ask() -> None:
    with Client(run.path, clock=run.clock, sleep=run.sleep) as client:
        run.sleep(0.4)
        axis = client.measure()["knee"]
        found["client"] = {name: getattr(axis, name) for name in axis.__struct_fields__}
        found["status"] = client.ask(Status())["axes"][0]


run.control(0.0, ask)
run.simulate()
run.close()
(table,) = convert(folder / "out" / "tsa.mcap", folder / "out.csv")
found["log"] = table.path.read_text().splitlines()
found["screen"] = [signal.name for signal in SHOWN]
found["dashboard"] = [(signal["chart"], signal["name"]) for signal in signals_shown()]
found["live"] = list(schema_of("signals", Place.CLIENT)["properties"])
found["layouts"] = [foxglove_layout(["knee"]), plotjuggler_layout(["knee"])]
found["manual"] = manual_table()
print(json.dumps(found))
"""


def run(table: Path, folder: Path) -> dict[str, Any]:
    """Run the loop with this table of signals and return its outputs.

    They contain the values of client and status at 0.4 s, and the rows of the log as CSV. They also contain the lists
    of signals in the displays and the manual.
    """
    folder.mkdir()
    done = subprocess.run([sys.executable, "-c", RUN, table, folder], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.slow
@pytest.mark.skipif(find_spec("foxglove") is None or find_spec("uvicorn") is None, reason="needs live and dashboard")
def test_a_row_of_the_table_is_all_that_a_signal_needs(tmp_path: Path) -> None:
    """The added row exports the rate of the set-point, which the loop computes anyway.

    After the fade-in the rate is 0.5 pi cos(pi t) N*m/s.
    """
    source = ROOT / "tsa_ctrl" / "signals.py"
    with_row = tmp_path / "signals.py"
    text = source.read_text(encoding="utf-8")
    last = '    Signal("drive_age"'
    assert text.count(last) == 1
    with_row.write_text(text.replace(last, ROW + last), encoding="utf-8")
    before, after = run(source, tmp_path / "before"), run(with_row, tmp_path / "after")
    assert set(before["client"]) == set(CLIENT.split())
    assert set(before["status"]) == set(STATUS.split())
    assert set(after["client"]) - set(before["client"]) == {"follow_rate"}
    assert set(after["status"]) - set(before["status"]) == {"follow_rate"}
    names = after["log"][0].split(",")
    assert set(names) - set(before["log"][0].split(",")) == {"follow_rate"}
    place = names.index("follow_rate")
    values = [float(row.split(",")[place]) for row in after["log"][1:]]
    assert after["client"]["follow_rate"] in values
    assert after["status"]["follow_rate"] in values
    assert max(values) == pytest.approx(1.5707963, rel=0.1)
    shown = set(map(tuple, after["dashboard"])) - set(map(tuple, before["dashboard"]))
    assert shown == {("rate", "follow_rate")}
    assert set(after["screen"]) - set(before["screen"]) == {"follow_rate"}
    assert set(after["live"]) - set(before["live"]) == {"follow_rate"}
    for text in (*after["layouts"], after["manual"]):
        assert "follow_rate" in text


def test_the_log_has_its_columns_in_order() -> None:
    assert list(FIELD_NAMES) == LOG.split()
