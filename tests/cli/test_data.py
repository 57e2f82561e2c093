"""Test `tsa data fetch`: downloads are verified byte for byte, and a failed download is a one-line error."""

from __future__ import annotations

import functools
import gzip
import hashlib
import http.server
import json
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tsa_ctrl.cli import main
from tsa_ctrl.errors import BusError, UsageError
from tsa_ctrl.identify.dataset import load_log
from tsa_ctrl.model.parameters import load_model
from tsa_ctrl.published import catalogue
from tsa_ctrl.published.catalogue import SETS, File, Published
from tsa_ctrl.published.fetch import cable_tool, drive_recorder, fetch, linear_axis

RECORDED = "Date:;2020\nms;rpm;%\n0.000;99;37.2\n12.800;-99;0.0\n"
BECOMES = "t,tau_m,omega_m\n0,-0.00366048,-10.3672558\n0.0128,-0,10.3672558\n"


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments: object) -> None:
        pass


@pytest.fixture
def home(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """Yield the address of a local HTTP server and the folder that it serves."""
    folder = tmp_path / "home"
    folder.mkdir()
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", folder
        server.shutdown()
        thread.join()


class OneLog(Published):
    @property
    def files(self) -> tuple[File, ...]:
        return (File("a/99.csv", "steady/p099.csv.gz", hashlib.sha256(BECOMES.encode()).hexdigest()),)


ONE = OneLog("epos", "one log", "http://nowhere", "drive_recorder", "MIT", "nobody", "drive.toml")


@pytest.mark.slow
def test_a_set_is_fetched_converted_and_kept(home: tuple[str, Path], tmp_path: Path) -> None:
    address, folder = home
    (folder / "a").mkdir()
    (folder / "a/99.csv").write_text(RECORDED)
    done = fetch(ONE, tmp_path / "out", address)
    assert (done.written, done.kept) == (1, 0)
    assert gzip.decompress((done.folder / "steady/p099.csv.gz").read_bytes()).decode() == BECOMES
    assert "MIT" in (done.folder / "SOURCE.txt").read_text()
    again = fetch(ONE, tmp_path / "out", "http://127.0.0.1:9")  # sends no request
    assert (again.written, again.kept) == (0, 1)
    path = done.folder / "steady/p099.csv.gz"
    whole = path.read_bytes()
    for damaged in (b"torn", whole[:-9], whole[:10] + b"\xff" + whole[11:]):
        path.write_bytes(damaged)
        assert fetch(ONE, tmp_path / "out", address).written == 1


def test_other_bytes_than_the_published_ones_are_refused_and_nothing_is_kept(
    home: tuple[str, Path], tmp_path: Path
) -> None:
    address, folder = home
    (folder / "a").mkdir()
    (folder / "a/99.csv").write_text(RECORDED.replace("37.2", "37.3"))
    with pytest.raises(UsageError, match="is not the published file"):
        fetch(ONE, tmp_path / "out", address)
    (folder / "a/99.csv").write_text("<html>moved</html>")
    with pytest.raises(UsageError, match="not the published file"):
        fetch(ONE, tmp_path / "out", address)
    assert not list((tmp_path / "out").rglob("*.gz"))


@pytest.mark.parametrize(
    "address", ["http://127.0.0.1:9", "nonsense", "http://[", "file:///nowhere", "http://127.0.0.1:9/a b"]
)
def test_offline_is_one_line(address: str, tmp_path: Path) -> None:
    with pytest.raises(BusError, match="cannot be reached"):
        fetch(ONE, tmp_path, address)
    assert not list(tmp_path.rglob("*.gz"))


def test_a_set_that_is_not_there_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["data", "fetch", "davinchi"])
    said = capsys.readouterr()
    assert (ended.value.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert "did you mean 'davinci'?" in said.err


def test_the_list_says_what_is_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(catalogue.VARIABLE, str(tmp_path))
    (tmp_path / "emps").mkdir()
    with pytest.raises(SystemExit):
        main(["data", "list", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["folder"] == str(tmp_path)
    assert {name: row["here"] for name, row in said["sets"].items()} == {"davinci": False, "emps": True, "epos": False}


@pytest.mark.parametrize("name", SETS)
def test_every_set_has_logs_a_licence_and_a_model_that_is_read(name: str, tmp_path: Path) -> None:
    one = SETS[name]
    assert one.licence
    assert one.cite
    assert len({file.name for file in one.files}) == len(one.files) > 0
    (tmp_path / one.model).write_text(one.model_text)
    load_model(tmp_path / one.model)


def test_counts_of_the_cable_tool_become_radians_and_newton_metres() -> None:
    """The input is the first row of a trial, with the count scales that its README states."""
    raw = b"%header\n0.000,1364,412,0.0500,189,-220,0.1000,-0.0315,-5888,1365.33\n"
    assert cable_tool(raw, "x").splitlines()[1] == "0.000,-1.046175,0.016402,0.296881,0.008758"


def test_the_recorder_of_the_drive_becomes_si() -> None:
    assert drive_recorder(RECORDED.encode(), "x") == BECOMES


def test_matlab_columns_become_ours(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(
        tmp_path / "a.mat",
        {
            "t": np.array([[0.0], [1e-3]]),
            "vir": np.array([[1.0], [-2.0]]),
            "qm": np.array([[0.1], [0.2]]),
            "gtau": 35.15,
        },
    )
    assert linear_axis((tmp_path / "a.mat").read_bytes(), "x") == "t,tau_m,q_m\n0,35.15,0.1\n0.001,-70.3,0.2\n"
    with pytest.raises(UsageError, match="not the published file"):
        linear_axis(b"MATLAB 5.0 nonsense", "x")


@pytest.mark.parametrize("name", SETS)
def test_the_check_sums_are_those_of_the_sets_that_are_here(name: str, data_dir: Path) -> None:
    for file in SETS[name].files:
        path = data_dir / name / file.name
        assert hashlib.sha256(gzip.decompress(path.read_bytes())).hexdigest() == file.sha256, file.name
    assert len(load_log(data_dir / name / SETS[name].files[-1].name)) > 100
