"""Binary files of other programs: one function per format, which returns named columns.

A format is read by the library that its users use; the extra `formats` of pyproject.toml installs them.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError

Columns = dict[str, NDArray[Any]]
TIME = "time [s]"  # of a format whose samples have their time separate from the columns
# A list of names next to lists of values: dSPACE (Name, Data), Simulink (label, values), JointState of ROS (name, ...)
LABELS = ("Name", "label", "name")


def library(name: str, path: Path) -> Any:
    """Import the library of a format; raise UsageError with the remedy if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.split(".")[0]
        raise UsageError(f"{path}: reading this format needs the package {package}; pip install '.[formats]'") from None


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers and arrays inside nested mappings, lists and messages, with names joined by dots."""
    if not isinstance(value, Mapping) and (fields := getattr(value, "__dict__", None) or _slots(value)):
        value = fields
    if isinstance(value, Mapping):
        texts = next(([str(label) for label in value[key]] for key in LABELS if _is_texts(value.get(key))), [])
        for key, inner in value.items():
            whole = f"{name}.{key}" if name else str(key)
            if texts and not isinstance(inner, str) and np.ndim(inner) <= 2 and _length(inner) == len(texts):
                for label, element in zip(texts, inner, strict=True):
                    yield from flat(element, label if key in ("Data", "values") else f"{whole}.{label}")
            elif not str(key).startswith("__"):
                yield from flat(inner, whole)
    elif isinstance(value, list) and any(isinstance(element, (dict, list, np.ndarray)) for element in value):
        for i, element in enumerate(value, start=1):
            yield from flat(element, f"{name}.{i}")
    elif np.asarray(value).dtype.kind in "fiubM":
        yield name, np.asarray(value)


def _slots(value: Any) -> dict[str, Any]:
    return {key: getattr(value, key) for key in getattr(value, "__slots__", ()) if not key.startswith("_")}


def _is_texts(value: Any) -> bool:
    return isinstance(value, (list, np.ndarray)) and len(value) > 0 and all(isinstance(text, str) for text in value)


def _length(value: Any) -> int:
    return len(value) if isinstance(value, (list, np.ndarray)) else -1


def columns(found: Iterator[tuple[str, Any]], path: Path) -> Columns:
    """Split matrices into columns and keep the ones of the most common length; raise UsageError without any."""
    every: Columns = {}
    for name, values in found:
        array = np.squeeze(np.asarray(values))
        if array.dtype.names:
            every |= {field: array[field] for field in array.dtype.names}
        elif array.ndim == 1 and array.size > 1:
            every[name or "column 1"] = array
        elif array.ndim == 2:
            by_column = (
                array if array.shape[0] >= array.shape[1] else array.T
            )  # a signal has more samples than a file signals
            every |= {f"{name}.{i}" if name else f"column {i}": c for i, c in enumerate(by_column.T, start=1)}
    if not every:
        raise UsageError(f"{path}: holds no column of numbers; give a file with at least a time and a torque")
    lengths = [len(column) for column in every.values()]
    rows = max(lengths, key=lambda length: (lengths.count(length), length))
    return {name: column for name, column in every.items() if len(column) == rows}


def on_one_clock(tables: Mapping[str, tuple[NDArray[np.float64], Columns]]) -> Columns:
    """Interpolate tables with separate clocks onto the densest clock; NaN outside a table's time."""
    clock = max((t for t, _ in tables.values()), key=len)
    clock = clock[np.concatenate([[True], np.diff(np.maximum.accumulate(clock)) > 0])]
    found: Columns = {TIME: clock - clock[0]}
    for t, table in tables.values():
        for name, values in table.items():
            good = np.isfinite(values.astype(float))
            if good.any():
                found[name] = np.interp(clock, t[good], values[good].astype(float), left=np.nan, right=np.nan)
    return found


def mat(path: Path) -> Columns:
    """MATLAB v5 and v7.3, with the structures that Simulink and dSPACE write."""
    return columns(flat(library("pymatreader", path).read_mat(path)), path)


def numpy_file(path: Path) -> Columns:
    """NumPy's .npy and .npz, without pickled objects, which could run code."""
    found = np.load(path, allow_pickle=False)
    return columns(iter([("", found)] if isinstance(found, np.ndarray) else list(found.items())), path)


def hdf5(path: Path) -> Columns:
    """HDF5: each data set by its path; an attribute `unit` or `units` becomes part of the name."""
    h5py, found = library("h5py", path), []
    with h5py.File(path) as file:

        def visit(name: str, node: Any) -> None:
            if isinstance(node, h5py.Dataset) and (node.dtype.kind in "fiub" or node.dtype.names):
                unit = node.attrs.get("unit", node.attrs.get("units"))
                found.append((f"{name} [{unit}]" if unit is not None else name, node[()]))

        file.visititems(visit)
    return columns(iter(found), path)


def tdms(path: Path) -> Columns:
    """LabVIEW TDMS: each channel, with the time of its waveform if it has one."""
    tables: dict[str, tuple[NDArray[np.float64], Columns]] = {}
    plain: Columns = {}
    for group in library("nptdms", path).TdmsFile.read(path).groups():
        for channel in group.channels():
            if channel.data.dtype.kind not in "fiubM":
                continue
            unit = channel.properties.get("unit_string")
            name = f"{channel.name} [{unit}]" if unit else channel.name
            if "wf_increment" in channel.properties:
                tables[f"{group.name}/{name}"] = (channel.time_track(), {name: channel.data})
            else:
                plain[name] = channel.data
    return on_one_clock(tables) if tables else columns(iter(plain.items()), path)


def parquet(path: Path) -> Columns:
    """Parquet of any program, by DuckDB."""
    import duckdb

    found = duckdb.execute("SELECT * FROM read_parquet(?)", [str(path)]).fetchnumpy()
    return columns(
        ((name, np.ma.filled(c.astype(float), np.nan)) for name, c in found.items() if c.dtype.kind in "fiub"), path
    )


def ros(path: Path) -> Columns:
    """A bag of ROS 1 (.bag) or ROS 2 (a folder, or its .db3): the numbers of each topic at the time of the record."""
    rosbags, stores = library("rosbags.highlevel", path), library("rosbags.typesys", path)
    bag = path if path.is_dir() or path.suffix == ".bag" else path.parent
    with rosbags.AnyReader([bag], default_typestore=stores.get_typestore(stores.Stores.ROS2_HUMBLE)) as reader:
        found = ((c.topic, stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages())
        return _messages(found, path)


def mcap(path: Path) -> Columns:
    """MCAP of other programs: messages in JSON or of ROS 2."""
    reading, decoding = library("mcap.reader", path), library("mcap_ros2.decoder", path)

    def messages() -> Iterator[tuple[str, int, Any]]:
        with path.open("rb") as stream:
            factory = decoding.DecoderFactory()
            for schema, channel, message in reading.make_reader(stream).iter_messages():
                if channel.message_encoding == "json":
                    yield channel.topic, message.log_time, json.loads(message.data)
                elif (decoder := factory.decoder_for(channel.message_encoding, schema)) is not None:
                    yield channel.topic, message.log_time, decoder(message.data)

    return _messages(messages(), path)


def _messages(found: Iterator[tuple[str, int, Any]], path: Path) -> Columns:
    """Collect the single numbers of messages (topic, ns, message), each topic on its own clock."""
    rows: dict[str, tuple[list[int], dict[str, list[Any]]]] = {}
    for topic, stamp, message in found:
        stamps, numbers = rows.setdefault(topic, ([], {}))
        stamps.append(stamp)
        for name, value in flat(message, topic.strip("/")):
            flat_value = np.ravel(value)
            if flat_value.size == 1 and ".header." not in name:
                numbers.setdefault(name, [np.nan] * (len(stamps) - 1)).append(float(flat_value[0]))
        for values in numbers.values():
            values += [np.nan] * (len(stamps) - len(values))
    if not any(numbers for _, numbers in rows.values()):
        raise UsageError(f"{path}: no topic holds numbers; give a record with at least a torque")
    first = min(stamps[0] for stamps, _ in rows.values())
    return on_one_clock(
        {
            topic: ((np.array(stamps) - first) * 1e-9, {name: np.array(values) for name, values in numbers.items()})
            for topic, (stamps, numbers) in rows.items()
        }
    )


def sheet(path: Path) -> str:
    """The first sheet of a workbook as text, for the reader of text tables."""
    rows = library("python_calamine", path).CalamineWorkbook.from_path(path).get_sheet_by_index(0).to_python()
    return "\n".join("\t".join(str(cell).replace("\t", " ").replace("\n", " ") for cell in row) for row in rows)


def lvm(path: Path) -> str:
    """LabVIEW's text without its two heads and its column of comments, which most rows do not have."""
    lines = path.read_text(encoding="cp1252").splitlines()
    heads = [i for i, line in enumerate(lines) if line.startswith("***End_of_Header***")]
    if not heads:
        raise UsageError(f"{path}: has no line ***End_of_Header***; export it from LabVIEW again")
    table = [line.split("\t") for line in lines[heads[-1] + 1 :] if line.strip()]
    width = len(table[0]) - (table[0][-1].strip() == "Comment") if table else 0
    return "\n".join("\t".join(row[:width]) for row in table).replace("X_Value", TIME, 1)


ARRAYS: dict[str, Callable[[Path], Columns]] = {
    ".mat": mat, ".npy": numpy_file, ".npz": numpy_file, ".h5": hdf5, ".hdf5": hdf5, ".tdms": tdms,
    ".parquet": parquet, ".bag": ros, ".db3": ros, "": ros, ".mcap": mcap,
}  # fmt: skip
TEXTS: dict[str, Callable[[Path], str]] = {".xlsx": sheet, ".xls": sheet, ".ods": sheet, ".lvm": lvm}


def read_with(reader: Callable[[Path], Any], path: Path) -> Any:
    """Call a reader; raise UsageError in one line for a file that its library cannot read."""
    if not path.exists():
        raise UsageError(f"{path}: no such file; give the path of a table")
    try:
        return reader(path)
    except UsageError:
        raise
    except Exception as error:  # each library raises its own errors, and a damaged file must not print a traceback
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UsageError(
            f"{path}: is damaged or no {path.suffix or 'ROS 2'} file ({reason}); export it again"
        ) from None
