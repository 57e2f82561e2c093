"""Files of every format give the same log. Most of the files are written by third-party libraries."""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.log.logs import import_log
from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign.binary import in_child
from tsa_ctrl.log.table import read_table

N = 50
T = np.arange(N) * 0.01
TORQUE = np.sin(20.0 * T)
NAMED = {"time": T, "motor_torque": TORQUE}
GIVEN = ("t=time|s", "tau_m=motor_torque|N*m")


def mat5(folder: Path) -> Path:
    scipy_io: Any = importlib.import_module("scipy.io")
    scipy_io.savemat(folder / "run.mat", NAMED)
    return folder / "run.mat"


def mat73(folder: Path) -> Path:
    importlib.import_module("hdf5storage").savemat(str(folder / "run.mat"), NAMED, format="7.3")
    return folder / "run.mat"


def simulink(folder: Path) -> Path:
    """Write a structure with time and two signals, like the block To Workspace."""
    scipy_io: Any = importlib.import_module("scipy.io")
    signals = np.array([(TORQUE, "motor_torque"), (T, "other")], dtype=[("values", object), ("label", object)])
    scipy_io.savemat(folder / "run.mat", {"out": {"time": T, "signals": signals}})
    return folder / "run.mat"


def dspace(folder: Path) -> Path:
    """Write a capture of ControlDesk: X contains the time, Y the name and data of each signal."""
    scipy_io: Any = importlib.import_module("scipy.io")
    kind = [("Name", object), ("Data", object)]
    x, y = np.array([("time", T), ("t2", T)], dtype=kind), np.array([("motor_torque", TORQUE), ("b", T)], dtype=kind)
    scipy_io.savemat(folder / "run.mat", {"capture": {"X": x, "Y": y}})
    return folder / "run.mat"


def controldesk(folder: Path) -> Path:
    """Write two rasters of a ControlDesk recorder, in the layout that third-party readers expect."""
    parts = []
    for n, name in ((10, "slow"), (N, "motor_torque")):
        rows = [f"{a!r},{b!r}" for a, b in zip(T[:n].tolist(), TORQUE[:n].tolist(), strict=True)]
        head = ["recorder,1", "raster,HostService", f"trace_names,time,{name}", "path,,Model Root/Drive", "unit,s,N*m"]
        parts.append("\n".join([*head, f"trace_values,{rows[0]}", *(f",{row}" for row in rows[1:])]))
    (folder / "run.csv").write_text("\n\n".join(parts) + "\n")
    return folder / "run.csv"


def h5(content: Callable[[Any], None], name: str = "run.h5") -> Callable[[Path], Path]:
    """Return the writer of an HDF5 file with this content."""

    def write(folder: Path) -> Path:
        with importlib.import_module("h5py").File(folder / name, "w") as file:
            content(file)
        return folder / name

    return write


def signals(file: Any) -> None:
    for name, values in NAMED.items():
        file[f"rig/{name}"] = values


def matrix(file: Any) -> None:
    """Write a matrix whose attributes have the names and units of its columns."""
    file["rig/data"] = np.column_stack([1e3 * T, 1e3 * TORQUE])
    file["rig/data"].attrs["columns"] = ["time", "motor_torque"]
    file["rig/data"].attrs["units"] = ["ms", "mNm"]


def groups(file: Any) -> None:
    """Write a group for each signal, with its unit as an attribute."""
    for name, values, unit in (("time", T, "s"), ("motor_torque", 1e3 * TORQUE, "mNm")):
        file[f"{name}/data"] = values
        file[name].attrs["unit"] = unit


def pandas(file: Any) -> None:
    """Write the layout of pandas' fixed format: blocks of one type, with the names of their columns."""
    for i, names in enumerate((["a", "b"], ["time", "motor_torque"])):
        file[f"df/block{i}_items"] = np.array(names, dtype="S")
        file[f"df/block{i}_values"] = np.column_stack([T, TORQUE]) * (1 if i else 7)


def rows(file: Any) -> None:
    table = np.empty(N, dtype=[("time", "f8"), ("pair", "f8", 2), ("motor_torque", "f8")])
    table["time"], table["pair"], table["motor_torque"] = T, 0.0, TORQUE
    file["log"] = table


def loop(file: Any) -> None:
    """Write a group with a link to itself. The file has the name of MATLAB's files, but not their header."""
    signals(file)
    file["rig/self"] = importlib.import_module("h5py").SoftLink("/rig")


def mat_names(folder: Path) -> Path:
    """Write a matrix next to the names of its columns, as MATLAB's importdata returns them."""
    names = np.array(["time", "motor_torque"], dtype=object)
    importlib.import_module("scipy.io").savemat(
        folder / "run.mat", {"data": np.column_stack([T, TORQUE]), "colheaders": names}
    )
    return folder / "run.mat"


def json_rows(folder: Path) -> Path:
    rows = [{"time": t, "motor_torque": x, "note": "a"} for t, x in zip(T.tolist(), TORQUE.tolist(), strict=True)]
    (folder / "run.json").write_text(json.dumps(rows))
    return folder / "run.json"


def json_lines(folder: Path) -> Path:
    rows = json.loads(json_rows(folder).read_text())
    (folder / "run.jsonl").write_text("\n".join(map(json.dumps, rows)))
    return folder / "run.jsonl"


def json_nested(folder: Path) -> Path:
    rows = json.loads(json_rows(folder).read_text())
    (folder / "run.json").write_text(json.dumps({"about": {"rig": 3}, "samples": rows}))
    return folder / "run.json"


def json_indexed(folder: Path) -> Path:
    columns = {name: {str(i): value for i, value in enumerate(values.tolist())} for name, values in NAMED.items()}
    (folder / "run.json").write_text(json.dumps(columns))
    return folder / "run.json"


def text_as_workbook(folder: Path) -> Path:
    np.savetxt(folder / "run.xls", np.column_stack([T, TORQUE]), delimiter="\t", header="\t".join(NAMED), comments="")
    return folder / "run.xls"


def npz(folder: Path) -> Path:
    np.savez(folder / "run.npz", time=T, motor_torque=TORQUE)
    return folder / "run.npz"


def npy(folder: Path) -> Path:
    np.save(folder / "run.npy", np.column_stack([T, TORQUE]))
    return folder / "run.npy"


def xlsx(folder: Path) -> Path:
    book = importlib.import_module("openpyxl").Workbook()
    for row in [tuple(NAMED), *zip(T.tolist(), TORQUE.tolist(), strict=True)]:
        book.active.append(row)
    book.save(folder / "run.xlsx")
    return folder / "run.xlsx"


def tdms(folder: Path) -> Path:
    nptdms = importlib.import_module("nptdms")
    waveform = {"wf_increment": 0.01, "wf_start_offset": 0.0, "wf_samples": N}
    with nptdms.TdmsWriter(folder / "run.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("rig", "motor_torque", TORQUE, properties=waveform)])
    return folder / "run.tdms"


def lvm(folder: Path) -> Path:
    """Write the documented text format of LabVIEW's Write To Measurement File."""
    head = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\n\nChannels\t1\t\t\nSamples\t50\t\t\n"
    rows = "".join(f"{a!r}\t{b!r}\n" for a, b in zip(T.tolist(), TORQUE.tolist(), strict=True))
    (folder / "run.lvm").write_text(f"{head}***End_of_Header***\t\t\nX_Value\tmotor_torque\tComment\n{rows}")
    return folder / "run.lvm"


def parquet(folder: Path) -> Path:
    import duckdb

    rows = duckdb.connect()
    rows.execute("CREATE TABLE x (time DOUBLE, motor_torque DOUBLE)")
    rows.executemany("INSERT INTO x VALUES (?, ?)", list(zip(T.tolist(), TORQUE.tolist(), strict=True)))
    rows.execute(f"COPY x TO '{folder / 'run.parquet'}' (FORMAT parquet)")
    return folder / "run.parquet"


def mcap(folder: Path) -> Path:
    writing = importlib.import_module("mcap.writer")
    with (folder / "run.mcap").open("wb") as stream:
        writer = writing.Writer(stream)
        writer.start()
        schema = writer.register_schema("torque", "jsonschema", b"{}")
        channel = writer.register_channel("/motor_torque", "json", schema)
        for i in range(N):
            data = json.dumps({"data": TORQUE[i]}).encode()
            writer.add_message(channel, round(T[i] * 1e9), data, round(T[i] * 1e9))
        writer.finish()
    return folder / "run.mcap"


def bag(version: int) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        stores = importlib.import_module("rosbags.typesys")
        if version == 1:
            store = stores.get_typestore(stores.Stores.ROS1_NOETIC)
            path, writing = folder / "run.bag", importlib.import_module("rosbags.rosbag1")
            writer, serialize = writing.Writer(path), store.serialize_ros1
        else:
            store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
            path, writing = folder / "run", importlib.import_module("rosbags.rosbag2")
            writer, serialize = writing.Writer(path, version=8), store.serialize_cdr
        kind = store.types["sensor_msgs/msg/JointState"]
        header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
        with writer:
            where = writer.add_connection("/motor_torque", kind.__msgtype__, typestore=store)
            for i in range(N):
                fields = {"stamp": stamp(0, 0), "frame_id": "", **({"seq": i} if version == 1 else {})}
                none = np.zeros(0)
                message = kind(header(**fields), ["knee", "hip"], none, none, np.array([TORQUE[i], 9.0]))
                writer.write(where, round(T[i] * 1e9), serialize(message, kind.__msgtype__))
        return path

    return write


RECORDED = "t=time [s]|s"
CASES: list[tuple[str, Callable[[Path], Path], tuple[str, str]]] = [
    ("mat v5", mat5, GIVEN), ("mat v7.3", mat73, GIVEN),
    ("simulink", simulink, ("t=out.time|s", "tau_m=motor_torque|N*m")),
    ("dspace", dspace, GIVEN), ("controldesk", controldesk, ("t=time [s]|s", "tau_m=motor_torque [N*m]|N*m")),
    ("h5", h5(signals), ("t=rig/time|s", "tau_m=rig/motor_torque|N*m")), ("npz", npz, GIVEN),
    ("h5 matrix", h5(matrix, "run.nc"), ("t=time [ms]|ms", "tau_m=motor_torque [mNm]|mN*m")),
    ("h5 groups", h5(groups), ("t=time/data [s]|s", "tau_m=motor_torque/data [mNm]|mNm")),
    ("h5 pandas", h5(pandas), GIVEN),
    ("h5 rows", h5(rows), GIVEN), ("mat names", mat_names, GIVEN), ("json", json_rows, GIVEN),
    ("json nested", json_nested, ("t=samples.time|s", "tau_m=samples.motor_torque|N*m")),
    ("json indexed", json_indexed, GIVEN),
    ("h5 as mat", h5(loop, "run.mat"), ("t=rig/time|s", "tau_m=rig/motor_torque|N*m")),
    ("json lines", json_lines, GIVEN), ("text as workbook", text_as_workbook, GIVEN),
    ("npy", npy, ("t=column 1|s", "tau_m=column 2|N*m")), ("xlsx", xlsx, GIVEN),
    ("tdms", tdms, (RECORDED, GIVEN[1])), ("lvm", lvm, (RECORDED, GIVEN[1])), ("parquet", parquet, GIVEN),
    ("mcap", mcap, (RECORDED, "tau_m=motor_torque.data|N*m")),
    ("ros 1", bag(1), (RECORDED, "tau_m=motor_torque.effort.knee|N*m")),
    ("ros 2", bag(2), (RECORDED, "tau_m=motor_torque.effort.knee|N*m")),
]  # fmt: skip


@pytest.mark.parametrize(("name", "write", "given"), CASES, ids=[case[0] for case in CASES])
def test_a_file_of_others_becomes_the_same_log(
    name: str, write: Callable[[Path], Path], given: tuple[str, str], tmp_path: Path
) -> None:
    path = write(tmp_path)
    assert import_log(str(path), "--column", given[0], "--column", given[1], "--out", str(tmp_path / "out")) == 0
    found = read_table(tmp_path / "out/run.csv").columns
    np.testing.assert_allclose(found["t"], T, atol=1e-9)
    np.testing.assert_allclose(found["tau_m"], TORQUE, atol=1e-12)


def test_without_a_header_all_questions_come_at_once_and_yes_takes_the_proposals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savetxt(tmp_path / "run.csv", np.column_stack([TORQUE, T]), delimiter=",")
    line = (str(tmp_path / "run.csv"), "--out", str(tmp_path / "out"))
    assert import_log(*line) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "--yes accepts the proposals --column 't=column 2|s' --column 'tau_m=column 1|N*m'" in said
    assert import_log(*line, "--yes") == 0
    found = read_table(tmp_path / "out/run.csv").columns
    np.testing.assert_allclose(found["tau_m"], TORQUE, atol=1e-12)


@pytest.mark.parametrize("head", ["t,tau_M,tau_J", "t,tau_M [N*m],tau_J"])
def test_every_column_that_a_name_identifies_without_a_unit_has_a_proposal(
    head: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Optional columns alone raise no question."""
    stated = "N*m" in head
    np.savetxt(
        tmp_path / "run.csv",
        np.column_stack([T, TORQUE, 2.0 * TORQUE]),
        delimiter=",",
        comments="",
        header=head,
    )
    line = (str(tmp_path / "run.csv"), "--out", str(tmp_path / "out"))
    assert import_log(*line) == (0 if stated else 2)
    said = capsys.readouterr()
    assert "--column 'tau_j=tau_J|N*m'" in (said.out if stated else said.err)
    assert import_log(*line, "--yes") == 0
    found = read_table(tmp_path / "out/run.csv").columns
    np.testing.assert_allclose(found["tau_j"], 2.0 * TORQUE, atol=1e-12)


def test_a_stated_shape_is_taken_where_none_can_be_determined(tmp_path: Path) -> None:
    (tmp_path / "run.txt").write_text(
        "".join(f"{a}|{b}\n" for a, b in (("t", "x"), (0, 1), (1, 2), (2, 4))) + "words\n" * 300
    )
    table = '[table]\nencoding = "utf-8"\nseparator = "|"\ndecimal = "."\nheader = 1\n'
    columns = '[column.t]\nfrom = "t"\nunit = "s"\n[column.tau_m]\nfrom = "x"\nunit = "N*m"\n'
    (tmp_path / "map.toml").write_text(table + columns)
    assert (
        import_log(str(tmp_path / "run.txt"), "--map", str(tmp_path / "map.toml"), "--out", str(tmp_path / "out")) == 0
    )


def test_files_of_one_stem_are_kept_apart_and_nan_bursts_are_holes(tmp_path: Path) -> None:
    for name, torque in (("run.npz", 1.0), ("run.txt", 2.0)):
        values = np.full(N, torque)
        values[20:25] = np.nan
        if name.endswith("npz"):
            np.savez(tmp_path / name, t=T, tau_m=values)
        else:
            np.savetxt(tmp_path / name, np.column_stack([T, values]), delimiter=";", header="t;tau_m", comments="")
    assert import_log(str(tmp_path / "run.npz"), str(tmp_path / "run.txt"), "--out", str(tmp_path / "out")) == 0
    for name, torque in (("run_npz", 1.0), ("run_txt", 2.0)):
        found = read_table(tmp_path / f"out/{name}.csv").columns
        np.testing.assert_allclose(found["t"], np.delete(T, range(20, 25)), atol=1e-12)
        np.testing.assert_array_equal(found["tau_m"], np.full(N - 5, torque))


def test_a_missing_package_and_a_damaged_file_are_one_line_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.h5").write_bytes(b"no such thing")
    assert import_log(str(tmp_path / "run.h5"), "--out", str(tmp_path / "out")) == 2
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    assert import_log(str(tmp_path / "run.h5"), "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err
    assert "needs the package h5py; pip install '.[formats]'" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("suffix", ["", ".csv"])
def test_a_folder_that_is_no_bag_is_one_line(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / f"runs{suffix}"
    folder.mkdir()
    assert import_log(str(folder), "--out", str(tmp_path / "out")) == 2
    said = capsys.readouterr().err
    assert f"is a folder, and not a ROS 2 bag; give the files in it, such as {folder}/*.csv" in said
    assert said.count("\n") == 1


def test_a_timetable_of_matlab_is_one_line_with_the_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with importlib.import_module("h5py").File(tmp_path / "run.mat", "w", userblock_size=512) as file:
        file["tt"] = np.zeros((1, 6), dtype="u4")
        file["tt"].attrs["MATLAB_object_decode"] = np.int32(3)
        file["#subsystem#/MCOS"] = np.zeros((1, 3), dtype="u4")
    with (tmp_path / "run.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    assert import_log(str(tmp_path / "run.mat"), "--out", str(tmp_path / "out"), "--yes") == 2
    said = capsys.readouterr().err
    assert "has only objects that MATLAB alone can read (tt); export a timetable with writetimetable" in said
    assert said.count("\n") == 1


def crash(path: Path) -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.kill(os.getpid(), signal.SIGSEGV)


def test_a_reader_that_crashes_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is damaged: its reader crashed; export it again"):
        in_child(crash, tmp_path / "run.mat")
