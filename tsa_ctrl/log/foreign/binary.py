"""Read the binary files of other programs, and JSON, as named columns.

Each format has one function. It uses the common library of the format. The extra `formats` of pyproject.toml installs
these libraries.
"""

from __future__ import annotations

import difflib
import importlib
import itertools
import json
import pickletools
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsa_ctrl.errors import UsageError
from tsa_ctrl.log.foreign.clocks import Arrays, Columns, columns, on_one_clock, outside
from tsa_ctrl.log.foreign.names import is_time
from tsa_ctrl.log.foreign.units import are_units
from tsa_ctrl.system.process_supervisor import begin_worker, worker_context

# Keys of a list of names next to lists of values: dSPACE (Name, Data), Simulink (label, values), JointState of ROS
# (name, ...).
LABELS = ("Name", "label", "name")


def library(name: str, path: Path) -> Any:
    """Import the library of a format. Raise UsageError with the remedy if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.split(".")[0]
        raise UsageError(f"{path}: reading this format needs the package {package}; pip install '.[formats]'") from None


def flat(value: Any, name: str = "", group: str = "", joint: str = ".") -> Iterator[tuple[str, Any, str]]:
    """Yield the numbers and arrays inside nested mappings, lists and messages.

    A list of texts names the columns of a matrix in the same mapping.

    Args:
        value: mapping, list, message or number.
        name: name of `value`, whose parts are joined by `joint`.
        group: name of the mapping that contains `value`.
        joint: separator of the parts of a name.

    Yields:
        Name, value and group of each number or array.
    """
    if not isinstance(value, Mapping) and (fields := getattr(value, "__dict__", None) or _slots(value)):
        value = fields
    if isinstance(value, Mapping):
        keys = (*LABELS, *value)
        texts = next(([str(label) for label in value[key]] for key in keys if _is_texts(value.get(key))), [])
        records = _records(value)
        unit = f" [{_unit_in(value)}]" if _unit_in(value) else ""
        for i, record in enumerate(records):
            label = texts[i] if len(texts) == len(records) else i + 1
            yield from flat(record, f"{name}{joint}{label}".lstrip(joint), joint=joint)
        for key, inner in [] if records else value.items():
            whole = f"{name}{joint}{key}" if name else str(key)
            if texts and not isinstance(inner, str) and np.ndim(inner) <= 2 and _length(inner) == len(texts):
                for label, element in zip(texts, inner, strict=True):
                    short = key in ("Data", "values")
                    yield from flat(element, label if short else f"{whole}{joint}{label}", name, joint)
            elif names := _names_of(str(key), inner, value):
                for label, column in zip(names, np.asarray(inner).T, strict=True):
                    yield label, column, name
            elif not str(key).startswith("__"):
                named = whole if is_time(str(key)) or np.ndim(inner) != 1 else whole + unit
                yield from flat(inner, named, name, joint)
    elif isinstance(value, list) and any(isinstance(element, (dict, list, np.ndarray)) for element in value):
        for i, element in enumerate(value, start=1):
            yield from flat(element, f"{name}{joint}{i}", group, joint)
    elif np.asarray(value).dtype.kind in "fiubMm" or np.asarray(value).dtype.names:
        yield name, np.asarray(value), group


def _names_of(key: str, inner: Any, value: Mapping[Any, Any]) -> list[str]:
    """Return a name with its unit for each column of the matrix `inner`, from a list of texts in `value`, or []."""
    if np.ndim(inner) != 2 or np.asarray(inner).dtype.kind not in "fiub":
        return []
    lists = {
        str(other): [str(text).strip() for text in found]
        for other, found in value.items()
        if isinstance(found, (list, np.ndarray)) and len(found) == np.shape(inner)[1]
        if all(isinstance(text, str) for text in found)
    }
    units = next((lists.pop(other) for other in list(lists) if are_units(lists[other])), [])
    # The list whose key is most similar: block1_values has the columns block1_items.
    names = [other for other in lists if _is_texts(lists[other])]
    best = max(names, key=lambda other: difflib.SequenceMatcher(None, key, other).ratio(), default=None)
    if best is None:
        return []
    pairs = itertools.zip_longest(lists[best], units, fillvalue="")
    return [f"{name} [{unit}]" if unit else name for name, unit in pairs]


def _slots(value: Any) -> dict[str, Any]:
    return {key: getattr(value, key) for key in getattr(value, "__slots__", ()) if not key.startswith("_")}


def _unit_in(value: Mapping[Any, Any]) -> str:
    """Return the text of the entry `unit` or `units` of a mapping, or ""."""
    found = next((inner for key, inner in value.items() if str(key).lower() in ("unit", "units")), "")
    text = np.ravel(found)[0] if np.size(found) == 1 else ""
    return text.decode(errors="replace") if isinstance(text, bytes) else text if isinstance(text, str) else ""


def _records(value: Mapping[Any, Any]) -> list[dict[Any, Any]]:
    """Return the elements of a structure array whose elements have their own time, or an empty list."""
    clocks = [inner for key, inner in value.items() if isinstance(inner, list) and is_time(str(key))]
    if not clocks or not any(np.size(clock) > 1 for clock in clocks[0]):
        return []
    fields = {key: inner for key, inner in value.items() if _length(inner) == len(clocks[0])}
    return [{key: inner[i] for key, inner in fields.items()} for i in range(len(clocks[0]))]


def _is_texts(value: Any) -> bool:
    if not isinstance(value, (list, np.ndarray)) or not all(isinstance(text, str) and text.strip() for text in value):
        return False
    return 0 < len(value) == len(set(value))


def _length(value: Any) -> int:
    return len(value) if isinstance(value, (list, np.ndarray)) else -1


def mat(path: Path) -> Arrays:
    """Read MATLAB v5 and v7.3, including the structures that Simulink and dSPACE write."""
    h5py, names = library("h5py", path), None
    if h5py.is_hdf5(path):
        with h5py.File(path) as file:
            variables = {name: node for name, node in file.items() if not name.startswith("#")}
            names = [name for name, node in variables.items() if "MATLAB_object_decode" not in node.attrs]
            if not names:
                raise UsageError(
                    f"{path}: has only objects that MATLAB alone can read ({', '.join(variables)}); export a timetable "
                    "with writetimetable, or save table2struct(timetable2table(x), 'ToScalar', true)"
                )
    return columns(flat(library("pymatreader", path).read_mat(path, variable_names=names)), path)


def numpy_file(path: Path) -> Arrays:
    """Read NumPy's .npy and .npz. Reject pickled objects, which could run code."""
    found = np.load(path, allow_pickle=False)
    if isinstance(found, np.ndarray):
        return columns(iter([("", found, "")]), path)
    return columns(((name, values, name.rpartition("/")[0]) for name, values in found.items()), path)


def hdf5(path: Path) -> Arrays:
    """Read HDF5: each data set by its path.

    An attribute `unit` or `units` of a data set or of its group becomes part of the name. Texts next to a matrix, or in
    its attributes, name its columns. A frame of pandas has the names of its columns, in both of its formats.
    """
    h5py = library("h5py", path)

    def content(node: Any) -> Any:
        """Return the content of a data set, or a mapping of a group or of a data set with lists of texts."""
        lists = {key: found for key, each in node.attrs.items() if (found := _decoded(each)) is not None}
        if node.attrs.get("pandas_type") == b"frame_table" and "table" in node:
            return _frame(node["table"], _pickled_texts(node.attrs.get("info")))
        if not isinstance(node, h5py.Dataset):
            unit = _unit_in(node.attrs)
            own = [
                key for key in node if isinstance(node.get(key, getlink=True), h5py.HardLink)
            ]  # a link may be a loop
            inner = {named(key, node[key]): content(node[key]) for key in own}
            return {**lists, **({"unit": unit} if unit else {}), **inner}
        if node.attrs.get("kind") == DATES_OF_PANDAS:
            return node[()].astype("datetime64[ns]")
        found = _decoded(node[()]) if node.ndim == 1 and node.dtype.kind in "SO" else node[()]
        return {"": found, **lists} if node.ndim == 2 and lists else found

    def named(key: str, node: Any) -> str:
        unit = _unit_in(node.attrs) if isinstance(node, h5py.Dataset) else ""
        given = node.attrs.get("name", NONE_OF_PANDAS) if key == "axis1" else NONE_OF_PANDAS  # the index of a frame
        key = key if given == NONE_OF_PANDAS else given.decode(errors="replace")
        return f"{key} [{unit}]" if unit else key

    with h5py.File(path) as file:
        return columns(flat(content(file), joint="/"), path)


DATES_OF_PANDAS, NONE_OF_PANDAS = b"datetime64[ns]", b"N."  # attributes; the second is a pickled None


def _frame(table: Any, info: list[str]) -> dict[str, NDArray[Any]]:
    """Return the columns of a frame of pandas in the format "table", whose fields hold one or several columns each.

    Args:
        table: data set with one field for the index and one for each block of columns.
        info: texts in the attribute `info` of the frame, with the name of the index after "index_name".
    """
    rows, found = table[()], {}
    for field in rows.dtype.names:
        values, names = rows[field], _pickled_texts(table.attrs.get(f"{field}_kind")) or [field]
        if field == "index":
            names = info[info.index("index_name") + 1 :][:1] if "index_name" in info else names
        if table.attrs.get(f"{field}_kind") == DATES_OF_PANDAS:
            values = values.astype("datetime64[ns]")
        for name, column in zip(names, values.reshape(len(rows), -1).T, strict=False):
            found[name] = column
    return found


def _pickled_texts(data: Any) -> list[str]:
    """Return the texts of a pickled value in order, without executing it, or [] if it is not pickled."""
    if not isinstance(data, bytes):
        return []
    try:
        return [value for _, value, _ in pickletools.genops(data) if isinstance(value, str)]
    except ValueError:
        return []


def _decoded(texts: Any) -> list[str] | None:
    """Return an array of texts or bytes as a list of texts; None for another value."""
    found = [text.decode(errors="replace") if isinstance(text, bytes) else text for text in np.atleast_1d(texts)]
    return found if len(found) > 1 and all(isinstance(text, str) for text in found) else None


def tdms(path: Path) -> Arrays:
    """Read LabVIEW TDMS: each channel, with the time of its waveform if it has one."""
    tables: dict[str, tuple[NDArray[np.float64], Columns]] = {}
    plain: list[tuple[str, Any, str]] = []
    used: set[str] = set()
    for group in library("nptdms", path).TdmsFile.read(path).groups():
        for channel in group.channels():
            if channel.data.dtype.kind not in "fiubM":
                continue
            unit = channel.properties.get("unit_string")
            name = f"{channel.name} [{unit}]" if unit else channel.name
            name = f"{group.name}/{name}" if name in used else name
            used.add(name)
            if "wf_increment" in channel.properties:
                tables[f"{group.name}/{name}"] = (channel.time_track(), {name: channel.data})
            else:
                plain.append((name, channel.data, group.name))
    if not tables:
        return columns(iter(plain), path)
    merged = on_one_clock(tables)
    dropped = tuple(name for name, _, _ in plain)
    return Arrays(merged, dropped + outside({key: table for key, (_, table) in tables.items()}, merged))


def parquet(path: Path) -> Arrays:
    """Read Parquet of any program with DuckDB."""
    import duckdb

    def filled(values: Any) -> Any:
        return np.ma.filled(
            *((values, np.datetime64("NaT")) if values.dtype.kind == "M" else (values.astype(float), np.nan))
        )

    found = duckdb.execute("SELECT * FROM read_parquet(?)", [str(path)]).fetchnumpy()
    return columns(((name, filled(c), "") for name, c in found.items() if c.dtype.kind in "fiubM"), path)


def ros(path: Path) -> Arrays:
    """Read a bag of ROS 1 (.bag) or ROS 2 (a folder, or its .db3): the numbers of each topic by their record time."""
    rosbags, stores = library("rosbags.highlevel", path), library("rosbags.typesys", path)
    bag = path if path.is_dir() or path.suffix == ".bag" else path.parent
    with rosbags.AnyReader([bag], default_typestore=stores.get_typestore(stores.Stores.ROS2_HUMBLE)) as reader:
        found = ((c.topic, stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages())
        return _messages(found, path)


def mcap(path: Path) -> Arrays:
    """Read MCAP of other programs with messages in JSON or of ROS 2."""
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


def json_file(path: Path) -> Arrays:
    """Read JSON: lists of numbers by name, or one object per row, in a list or in a line each."""
    text = path.read_text(encoding="utf-8-sig")
    try:
        value = json.loads(text)
    except json.JSONDecodeError:
        value = [json.loads(line) for line in text.splitlines() if line.strip()]
    return columns(flat(_by_column(value)), path)


def _by_column(value: Any) -> Any:
    """Return JSON with a list of numbers for each list of objects, and for each object with the keys 0, 1, 2, ..."""
    if isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
        rows = [{name: number for name, number, _ in flat(row)} for row in value]
        names = dict.fromkeys(name for row in rows for name in row)
        return {name: np.array([row.get(name, np.nan) for row in rows], dtype=float) for name in names}
    if isinstance(value, dict) and value:
        counted = list(value) == [str(i) for i in range(len(value))]
        return list(value.values()) if counted else {key: _by_column(inner) for key, inner in value.items()}
    return value


def _messages(found: Iterator[tuple[str, int, Any]], path: Path) -> Arrays:
    """Collect the scalars of messages (topic, ns, message), with a separate clock for each topic."""
    rows: dict[str, tuple[list[int], dict[str, list[Any]]]] = {}
    for topic, stamp, message in found:
        stamps, numbers = rows.setdefault(topic, ([], {}))
        stamps.append(stamp)
        for name, value, _ in flat(message, topic.strip("/")):
            flat_value = np.ravel(value)
            if flat_value.size == 1 and ".header." not in name:
                numbers.setdefault(name, [np.nan] * (len(stamps) - 1)).append(float(flat_value[0]))
        for values in numbers.values():
            values += [np.nan] * (len(stamps) - len(values))
    if not any(numbers for _, numbers in rows.values()):
        raise UsageError(f"{path}: no topic contains numbers; give a recording with at least a torque")
    first = min(stamps[0] for stamps, _ in rows.values())
    tables = {
        topic: ((np.array(stamps) - first) * 1e-9, {name: np.array(values) for name, values in numbers.items()})
        for topic, (stamps, numbers) in rows.items()
    }
    merged = on_one_clock(tables)
    return Arrays(merged, outside({topic: table for topic, (_, table) in tables.items()}, merged))


ARRAYS: dict[str, Callable[[Path], Arrays]] = {
    ".mat": mat, ".npy": numpy_file, ".npz": numpy_file, ".h5": hdf5, ".hdf5": hdf5, ".tdms": tdms,
    ".parquet": parquet, ".bag": ros, ".db3": ros, ".mcap": mcap, ".json": json_file, ".jsonl": json_file,
}  # fmt: skip


SIGNATURES = {  # first bytes of a format, which decide if the name does not fit them
    b"\x89HDF": ".h5", b"PAR1": ".parquet", b"\x93NUMPY": ".npy", b"TDSm": ".tdms", b"\x89MCAP": ".mcap",
    b"#ROSBAG": ".bag", b"MATLAB 5": ".mat", b"MATLAB 7.3": ".mat", b"\xd0\xcf\x11\xe0": ".xls",
}  # fmt: skip


def format_of(path: Path) -> str:
    """Return the ending that the content of a file has by its first bytes, or else its name.

    A text with the ending of a workbook is a text: some programs name it .xls, so that a double click opens it.
    """
    if path.is_dir():
        if not list(path.glob("metadata.yaml")):
            raise UsageError(f"{path}: is a folder, and not a ROS 2 bag; give the files in it, such as {path}/*.csv")
        return ".db3"
    suffix = path.suffix.lower()
    try:
        with path.open("rb") as stream:
            head = stream.read(512)
    except OSError:
        return suffix  # the reader reports it
    content = next((ending for start, ending in SIGNATURES.items() if head.startswith(start)), "")
    if content:
        return content
    plain = suffix in (".xls", ".xlsx", ".ods") and head and not head.startswith(b"PK") and b"\0" not in head
    return "" if plain else suffix


def in_child(reader: Callable[[Path], Any], path: Path) -> Any:
    """Call a reader in a child process, because the C code of its library may crash on a damaged file.

    Raises:
        UsageError: The reader crashed.
    """
    from concurrent.futures import ProcessPoolExecutor  # imported here, because most tables are text
    from concurrent.futures.process import BrokenProcessPool

    with ProcessPoolExecutor(1, mp_context=worker_context(__name__), initializer=begin_worker) as pool:
        try:
            return pool.submit(reader, path).result()
        except BrokenProcessPool:
            raise UsageError(f"{path}: is damaged: its reader crashed; export it again") from None


def read_with(reader: Callable[[Path], Any], path: Path) -> Any:
    """Call a reader. Raise UsageError with a message of one line if its library cannot read the file."""
    if not path.exists():
        raise UsageError(f"{path}: no such file; give the path of a table")
    try:
        return in_child(reader, path) if reader is mat else reader(path)
    except UsageError:
        raise
    except Exception as error:  # each library raises its own errors, but a damaged file must not cause a traceback
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise UsageError(
            f"{path}: is damaged or not a {path.suffix or 'ROS 2'} file ({reason}); export it again"
        ) from None
