"""Write a diagnosis to a folder: diagnosis.json, extended.toml, experiment.csv, pictures and report.html.

The page is a single file that opens without a network connection. diagnosis.json contains all its numbers.
"""

from __future__ import annotations

import base64
import contextlib
import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Executor
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from tsa_ctrl import outputs, settings
from tsa_ctrl.errors import UsageError
from tsa_ctrl.identify.diagnosis.report.result import Diagnosis, Verdict
from tsa_ctrl.identify.diagnosis.report.words import (
    PICTURE_FILES,
    captions,
    four_lines,
    listed,
    remarks,
    spoken,
    summary_of,
    told_torque,
)
from tsa_ctrl.identify.provenance import provenance
from tsa_ctrl.identify.quantity import Quantity, spelled
from tsa_ctrl.model.parameters import save_model
from tsa_ctrl.model.provenance import Origin
from tsa_ctrl.version import __version__

JSON, MODEL, PAGE, EXPERIMENT = "diagnosis.json", "extended.toml", "report.html", "experiment.csv"
FORMULA = "formula.toml"  # the extended model with the formula of the residual as [effects.custom]
WORDS = {
    Verdict.CONSISTENT: "consistent: after recalibration nothing is left beyond noise",
    Verdict.EXPLAINED: "explained: causes are named and nothing significant is left",
    Verdict.PARTLY_EXPLAINED: "partly explained: causes are named, but structure is left",
    Verdict.UNEXPLAINED: "unexplained: there is structure that nothing in the catalogue explains",
    Verdict.INSUFFICIENT: "insufficient: the logs do not excite the system enough",
}


Plot = Callable[[Diagnosis, Path], dict[str, Path]]  # draws into a folder and returns the paths by caption


def write(
    result: Diagnosis,
    folder: str | Path,
    template: str | Path | None = None,
    plot: Plot | None = None,
    origin: Origin | None = None,
) -> None:
    """Write diagnosis.json, extended.toml, report.html with its pictures, and the experiment's set-point file.

    If a formula describes the residual, formula.toml is written as well. Each file is written under another name and
    then renamed, so a crash leaves no partial file. Files of an earlier report are treated as in `set_aside`.

    Args:
        result: the diagnosis.
        folder: folder of the report; it is created if necessary.
        template: model file whose comments extended.toml keeps.
        plot: function that draws the pictures (default: in this process).
        origin: origin of the measurements (default: logs, which may belong to any joint).

    Raises:
        UsageError: the folder cannot be written.
    """
    folder, template = Path(folder), None if template is None else Path(template)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".report.") as name:
            pictures = {}
            drawn = (plot or drawn_here)(result, Path(name))
            optional = [FORMULA] * (result.formula is not None) + [EXPERIMENT] * bool(result.experiment.t)
            set_aside(folder, [JSON, MODEL, PAGE, *optional, *(path.name for path in drawn.values())])
            for caption, path in drawn.items():
                shutil.move(path, folder / path.name)
                pictures[caption] = folder / path.name
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written ({error.strerror or error}); choose another --out") from None
    source = _provenance(result, template, origin)
    save_model(result.model, folder / MODEL, template, source)
    if result.formula is not None:
        save_model(result.formula.limited, folder / FORMULA, template, source)
    if result.experiment.t:
        settings.write_text(folder / EXPERIMENT, result.experiment.csv())
    settings.write_text(folder / PAGE, page(result, pictures, template))
    settings.write_text(folder / JSON, result.to_json())


def set_aside(folder: Path, new: Collection[str]) -> None:
    """Keep the data files of an earlier report as NAME.~N~, and remove each of its files that is not in `new`.

    A model or set-point of an earlier diagnosis therefore never appears as part of the new one. Raises OSError or
    UsageError.
    """
    data = (JSON, MODEL, FORMULA, EXPERIMENT)
    for name in data:
        outputs.keep(folder / name)
    for name in {*data, PAGE, *PICTURE_FILES} - set(new):
        (folder / name).unlink(missing_ok=True)


def drawn_here(result: Diagnosis, folder: Path) -> dict[str, Path]:
    """Draw the pictures in this process with `pictures.plot`, and return their paths by caption."""
    from tsa_ctrl.identify.diagnosis.report.pictures import plot  # matplotlib is slow to import

    return plot(result, folder)


def page(result: Diagnosis, pictures: dict[str, Path], template: Path | None = None) -> str:
    """Return the text of report.html, with the embedded pictures and the name of the model file.

    Args:
        result: the diagnosis.
        pictures: paths of the pictures by caption.
        template: the model file; None stands for the source of the result's model.
    """
    given = template or result.model.source
    environment = Environment(
        loader=PackageLoader("tsa_ctrl.identify.diagnosis.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        spoken=spoken, listed=listed, torque=told_torque, percent=_percent, number=_number, spelled=spelled
    )
    images = [(caption, base64.b64encode(path.read_bytes()).decode("ascii")) for caption, path in pictures.items()]
    return environment.get_template("report.html.j2").render(
        result=result,
        data=result.to_dict(),
        verdict=WORDS[result.verdict],
        causes=[_cause(cause.effect, cause.parameters) for cause in result.causes],
        first=dict(images[:1]),
        pictures=dict(images[1:]),
        details=result.details,
        experiment_file=EXPERIMENT if result.experiment.t else "",
        lines=four_lines(result),
        remarks=remarks(result),
        drive=result.model.kind.spoken,
        model=Path(given).name if given else "a model without a file",
        date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        version=__version__,
    )


def _cause(effect: str, parameters: Any) -> dict[str, Any]:
    rows = []
    for name, value in parameters.items():
        if isinstance(value, Quantity):
            if not value.told:
                interval = "not determined by these logs"
            else:
                known = value.high > value.low
                interval = f"{_number(value.low)} to {_number(value.high)}" if known else "given"
            rows.append((name, _number(value.value), interval, "" if value.unit == "1" else spelled(value.unit)))
        else:
            rows.append((name, value, "chosen", ""))
    return {"summary": summary_of(effect), "rows": rows}


def _provenance(result: Diagnosis, template: Path | None, origin: Origin | None) -> dict[str, object]:
    found = {
        f"{cause.effect}.{name}": value
        for cause in result.causes
        for name, value in cause.parameters.items()
        if isinstance(value, Quantity) and value.told
    }
    found |= {name: error.found for name, error in result.parameter_errors.items()}
    logs = {} if result.details is None else dict(result.details.logs)
    nominal = template or result.model.source
    return provenance("diagnose", logs, nominal, found, origin, verdict=result.verdict.value)


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{100.0 * value:.0f} %"


def _number(value: float) -> str:
    return f"{value:.4g}"


# The pictures are drawn in other processes, which load the drawing code while the search for causes runs. Loading and
# drawing take about a tenth of the time of the search.

PICTURES = "tsa_ctrl.identify.diagnosis.report.pictures"
PROCESSES = 2  # the search has ended when they draw, and three of the pictures take most of their time


@contextlib.contextmanager
def drawing() -> Iterator[Plot]:
    """Yield a function that draws the pictures in other processes, as `pictures.plot` does.

    If this process may use only one core, the function draws in this process.
    """
    if len(os.sched_getaffinity(0)) < 2:
        yield drawn_here
        return
    from tsa_ctrl.identify.fleet.executors import local  # its package imports this module

    with local(PROCESSES, PICTURES) as workers:
        # The first job starts the process that loads the drawing code. The executor accepts a job only after the code
        # is loaded, so a thread submits it.
        threading.Thread(target=_begin, args=(workers.executor,), daemon=True).start()
        yield partial(_plot_by, workers.executor)


def _begin(executor: Executor) -> None:
    with contextlib.suppress(RuntimeError, OSError):  # drawing runs into the same error and falls back to this process
        executor.submit(os.getpid)


def _plot_by(executor: Executor, result: Diagnosis, folder: Path) -> dict[str, Path]:
    try:
        made = {caption: executor.submit(_draw, result, name, folder) for name, caption in captions(result).items()}
        return {caption: path.result() for caption, path in made.items()}
    except (RuntimeError, OSError):  # the processes have ended, possibly for lack of memory
        return drawn_here(result, folder)


def _draw(result: Diagnosis, name: str, folder: Path) -> Path:
    from tsa_ctrl.identify.diagnosis.report.pictures import draw

    return draw(result, name, folder)
