"""Reading of the tables of a PEtab problem, version 1, with checks of each row.

Every row in ``Tables`` has its file and line. Formulas remain strings.

Source: PEtab data format specification, version 1.0.0, petab.readthedocs.io.

The package ``petab`` (0.8.2), which tests use, does not replace this module: of the 31 invalid
problems in ``tests/estimation/test_petab.py``, its linter accepts 9, and it never names the line of
a table. Its import takes 2.5 s of processor time, compared with 0.5 s for cotree's reader.
"""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.errors import SceneError, brief, nearest, optional_package
from cotree.estimation.estimated import SCALES
from cotree.files import read_text
from cotree.readers.names import LARGEST_FILE, SourceLine

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence


_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")

_Named = TypeVar("_Named", "ParameterRow", "ObservableRow", "ConditionRow")

#: Cell of the condition table: a number, a name, or None for the model's value.
Cell = float | str | None


@dataclass(frozen=True)
class TableRow:
    """A row of a table, with its file and line."""

    line: SourceLine  # file and line of the row, for messages
    cells: Mapping[str, str]  # cell texts by column

    def error(self, message: str) -> SceneError:
        """Return an error whose message begins with the file and line of this row."""
        return self.line.error(message)

    def text(self, column: str, default: str = "") -> str:
        """Return the text of a cell; the default if it is empty or the column is missing."""
        value = (self.cells.get(column) or "").strip()
        return default if value in ("", "NaN", "nan", "NA") else value

    def number(
        self, column: str, default: float | None = None, *, may_be_infinite: bool = False
    ) -> float:
        """Return the number in a cell; raise an error if it is empty and there is no default."""
        text = self.text(column)
        if not text:
            if default is None:
                raise self.error(f"'{column}' is empty: give a number")
            return default
        value = as_number(text)
        if value is None:
            raise self.error(f"'{column}' is '{brief(text)}', which is not a number")
        return value if may_be_infinite else self.finite(column, value)

    def finite(self, column: str, value: float) -> float:
        """Return ``value``, read from a cell; raise an error if it is infinite."""
        if math.isinf(value):
            raise self.error(f"'{column}' is {value}: give a finite number")
        return value

    def choice(self, column: str, known: Sequence[str]) -> str:
        """Return the word in a cell, by default the first of ``known``."""
        text = self.text(column, known[0])
        if text not in known:
            raise self.error(f"'{column}' is '{brief(text)}'{nearest(text, known)}")
        return text

    def identifier(self, column: str) -> str:
        """Return the identifier in a cell; raise an error if it is invalid."""
        text = self.text(column)
        if not _IDENTIFIER.match(text):
            raise self.error(
                f"'{column}' is '{brief(text)}': use letters, digits and underscores, and no digit "
                "at the beginning"
            )
        return text

    def listed(self, column: str) -> tuple[str | float, ...]:
        """Return the numbers and names in a cell, separated by semicolons."""
        text = self.text(column)
        parts = [part.strip() for part in text.split(";")] if text else []
        found: list[str | float] = []
        for part in parts:
            value = as_number(part)
            if value is None and not _IDENTIFIER.match(part):
                raise self.error(f"'{brief(part)}' in '{column}' is neither a number nor a name")
            found.append(part if value is None else self.finite(column, value))
        return tuple(found)


@dataclass(frozen=True)
class PriorRow:
    """A prior, with its type and its two parameters."""

    kind: str
    first: float
    second: float


@dataclass(frozen=True)
class ParameterRow:
    """A row of the parameter table, with unscaled bounds and nominal value."""

    name: str
    row: TableRow
    scale: str
    lower: float
    upper: float
    nominal: float | None
    is_estimated: bool
    objective_prior: PriorRow | None
    initialization_prior: PriorRow | None

    @property
    def value(self) -> float:
        """The nominal value, or 1 if there is none."""
        return 1.0 if self.nominal is None else self.nominal


@dataclass(frozen=True)
class ObservableRow:
    """A row of the observable table."""

    name: str
    row: TableRow
    formula: str
    noise: str
    transformation: str
    distribution: str


@dataclass(frozen=True)
class MeasurementRow:
    """A row of the measurement table; ``before`` is the preequilibration condition or empty."""

    row: TableRow
    observable: str
    condition: str
    before: str
    t: float
    value: float
    observable_parameters: tuple[str | float, ...]
    noise_parameters: tuple[str | float, ...]


@dataclass(frozen=True)
class ConditionRow:
    """A row of the condition table, with the values that it sets, by name."""

    name: str
    row: TableRow
    cells: Mapping[str, Cell]


@dataclass(frozen=True)
class Tables:
    """All tables of a problem; parameters, observables and conditions are mappings by name."""

    file: str  # name of the YAML file
    model: Path  # path of the SBML file
    measurement_files: Sequence[Path]  # measurement tables in the order of the YAML file
    parameters: Mapping[str, ParameterRow]
    observables: Mapping[str, ObservableRow]
    conditions: Mapping[str, ConditionRow]
    measurements: Sequence[MeasurementRow]

    @cached_property
    def columns(self) -> frozenset[str]:
        """The quantities set by at least one condition."""
        return frozenset(name for row in self.conditions.values() for name in row.cells)

    @cached_property
    def settable(self) -> frozenset[str]:
        """The quantities in the condition table or in the parameter table."""
        return self.columns | self.parameters.keys()

    @cached_property
    def estimated(self) -> list[ParameterRow]:
        """The parameters that are estimated."""
        found = [row for row in self.parameters.values() if row.is_estimated]
        if not found:
            raise SceneError(
                f"{self.file}: no parameter is estimated: set 'estimate' to 1 in a row"
            )
        return found


_PRIORS = (
    *("parameterScaleUniform", "parameterScaleNormal", "parameterScaleLaplace"),
    *("uniform", "normal", "laplace", "logNormal", "logLaplace"),
)


#: Names of the required columns of each table.
_COLUMNS = {
    "parameter": ("parameterId", "parameterScale", "nominalValue"),
    "observable": ("observableId", "observableFormula", "noiseFormula"),
    "condition": ("conditionId",),
    "measurement": ("observableId", "simulationConditionId", "measurement", "time"),
}


def as_number(text: str) -> float | None:
    """Convert a text to a number; None if it is no number, ``nan`` or too large for a double."""
    # Python also accepts underscores between digits.
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        return None
    is_beyond = math.isinf(value) and "n" not in text.lower()  # rejects 1e999, but not inf
    return None if math.isnan(value) or is_beyond else value


def _by_name(
    read: Callable[[TableRow], _Named], rows: Iterable[TableRow], what: str
) -> dict[str, _Named]:
    """Read rows to a mapping by name; raise an error if a name is not unique."""
    known: dict[str, _Named] = {}
    for row in rows:
        found = read(row)
        if found.name in known:
            line = known[found.name].row.line
            raise row.error(f"{what} '{brief(found.name)}' is defined twice, first in {line}")
        known[found.name] = found
    return known


def _rows(paths: Iterable[Path], *wanted: str) -> Iterable[TableRow]:
    """Yield the nonempty rows of tables; raise an error if columns are missing."""
    for path in paths:
        # ``newline=""`` passes line ends unchanged to the csv module, as it requires.
        text = io.StringIO(read_text(path, LARGEST_FILE), newline="")
        reader = csv.DictReader(text, delimiter="\t", strict=True)
        try:
            columns = reader.fieldnames or []
            for name in wanted:
                if name not in columns:
                    hint = nearest(name, columns) if columns else ""
                    if len(columns) == 1 and name in columns[0]:
                        hint = ": separate columns by tabs"
                    raise SceneError(f"{path}:1: no column '{name}'{hint}")
            for name in columns:
                if columns.count(name) > 1:
                    raise SceneError(
                        f"{path}:1: two columns are named '{brief(name)}': remove one of them"
                    )
            for cells in reader:
                row = TableRow(SourceLine(str(path), reader.line_num), cells)
                # The csv module stores cells beyond the header under the key None.
                if None in cells:
                    raise row.error(
                        f"the row has more cells than the {len(columns)} columns of the header"
                    )
                if any(row.text(name) for name in columns):
                    yield row
        except csv.Error as error:
            line = SourceLine(str(path), max(1, reader.line_num))
            raise line.error(f"not a table with tab-separated columns: {error}") from None


def _parameter(row: TableRow) -> ParameterRow:
    name, scale = row.identifier("parameterId"), row.choice("parameterScale", SCALES)
    estimate = row.text("estimate")
    if estimate not in ("0", "1", "0.0", "1.0"):
        raise row.error(f"'estimate' is '{brief(estimate)}': give 0 or 1")
    is_estimated = estimate.startswith("1")
    lower, upper = -math.inf, math.inf
    if is_estimated:
        lower = row.number("lowerBound", may_be_infinite=True)
        upper = row.number("upperBound", may_be_infinite=True)
        if not lower < upper:
            raise row.error(
                f"the lower bound {lower:g} of '{brief(name)}' is not below the upper bound "
                f"{upper:g}"
            )
        if scale != "lin" and lower < 0.0:
            raise row.error(
                f"'{brief(name)}' is on scale {scale}: its lower bound must not be negative"
            )
    nominal = row.number("nominalValue", math.nan)
    if not is_estimated and math.isnan(nominal):
        raise row.error(f"'{brief(name)}' is not estimated: give its nominalValue")
    if is_estimated and scale != "lin" and nominal <= 0.0:
        raise row.error(
            f"'{brief(name)}' is on scale {scale}: its nominalValue {nominal:g} must be positive"
        )
    return ParameterRow(
        name,
        row,
        scale,
        lower,
        upper,
        None if math.isnan(nominal) else nominal,
        is_estimated,
        _prior(row, "objectivePrior") if is_estimated else None,
        _prior(row, "initializationPrior") if is_estimated else None,
    )


def _prior(row: TableRow, column: str) -> PriorRow | None:
    kind, given = row.text(f"{column}Type"), row.listed(f"{column}Parameters")
    if not kind and not given:
        return None
    kind = row.choice(f"{column}Type", _PRIORS)
    numbers = [value for value in given if not isinstance(value, str)]
    if kind == "parameterScaleUniform" and not given:
        return None  # a uniform prior between the bounds is equivalent to no prior
    if len(numbers) != 2 or len(given) != 2:
        raise row.error(f"'{column}Parameters' of a {kind} prior must be two numbers, as in 0;1")
    first, second = numbers
    if kind.lower().endswith("uniform") and not first < second:
        raise row.error(
            f"the lower end {first:g} of a {kind} prior is not below the end {second:g}"
        )
    if not kind.lower().endswith("uniform") and not second > 0.0:
        raise row.error(f"the scale {second:g} of a {kind} prior is not positive")
    return PriorRow(kind, first, second)


def _observable(row: TableRow) -> ObservableRow:
    formula, noise = row.text("observableFormula"), row.text("noiseFormula")
    name = row.identifier("observableId")
    for column, text in (("observableFormula", formula), ("noiseFormula", noise)):
        if not text:
            raise row.error(f"'{column}' of observable '{brief(name)}' is empty")
    return ObservableRow(
        name,
        row,
        formula,
        noise,
        row.choice("observableTransformation", SCALES),
        row.choice("noiseDistribution", ("normal", "laplace")),
    )


def _condition(row: TableRow) -> ConditionRow:
    cells: dict[str, Cell] = {}
    for column in row.cells:
        if column in ("conditionId", "conditionName"):
            continue
        text = row.text(column)
        number = as_number(text) if text else None
        if number is None:
            cells[column] = row.identifier(column) if text else None
        else:
            cells[column] = row.finite(column, number)
    return ConditionRow(row.identifier("conditionId"), row, cells)


def _measurement(
    row: TableRow, observables: Mapping[str, ObservableRow], conditions: Mapping[str, ConditionRow]
) -> MeasurementRow:
    observable, before = row.text("observableId"), row.text("preequilibrationConditionId")
    condition = row.text("simulationConditionId")
    for column, name, known in (
        ("observableId", observable, observables),
        ("simulationConditionId", condition, conditions),
        ("preequilibrationConditionId", before, conditions if before else {"": None}),
    ):
        if name not in known:
            raise row.error(f"unknown {column} '{brief(name)}'{nearest(name, known)}")
    value, t = row.number("measurement"), row.number("time", may_be_infinite=True)
    if observables[observable].transformation != "lin" and not value > 0.0:
        raise row.error(f"the measurement {value:g} of '{brief(observable)}' has no logarithm")
    if not t >= 0.0:
        raise row.error(f"the time is {t:g}: times must not be negative")
    return MeasurementRow(
        row,
        observable,
        condition,
        before,
        t,
        value,
        row.listed("observableParameters"),
        row.listed("noiseParameters"),
    )


def read_tables(path: str | Path) -> Tables:
    """Read the tables that a YAML file lists."""
    data, folder = _parsed(path), Path(path).parent
    given = data["format_version"]
    version = str(given.get("version") if isinstance(given, dict) else given).strip()
    if version.split(".")[0] != "1":
        raise SceneError(
            f"{path}: format_version is {brief(version)}, but only version 1 of PEtab is supported"
        )
    problems = data.get("problems")
    if not isinstance(problems, list) or len(problems) != 1 or not isinstance(problems[0], dict):
        raise SceneError(f"{path}: 'problems' must list one problem: write a file for each")
    problem = problems[0]
    files = {
        kind: [_existing(path, folder, name) for name in _listed(path, problem, f"{kind}_files")]
        for kind in ("observable", "condition", "measurement")
    }
    files["parameter"] = [
        _existing(path, folder, name) for name in _listed(path, data, "parameter_file")
    ]
    if problem.get("mapping_files"):
        raise SceneError(
            f"{path}: mapping_files are not supported: use names of the model in the tables"
        )
    model = _existing(path, folder, _model(path, problem))
    rows = {kind: _rows(files[kind], *wanted) for kind, wanted in _COLUMNS.items()}
    parameters = _by_name(_parameter, rows["parameter"], "parameter")
    observables = _by_name(_observable, rows["observable"], "observable")
    conditions = _by_name(_condition, rows["condition"], "condition")
    measurements = [_measurement(row, observables, conditions) for row in rows["measurement"]]
    if not measurements:
        raise SceneError(f"{path}: the measurement table has no rows: add measured values")
    return Tables(
        str(path), model, files["measurement"], parameters, observables, conditions, measurements
    )


def _parsed(path: str | Path) -> dict[str, Any]:
    yaml = optional_package("yaml", "reading PEtab problems needs", "petab")
    text = read_text(path, LARGEST_FILE)
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        # Errors about invalid characters have the attribute ``reason`` instead of ``problem``.
        problem = getattr(error, "problem", None) or getattr(error, "reason", "nested too deeply")
        raise SceneError(f"{where}: not valid YAML: {problem}") from None
    if not isinstance(data, dict) or "format_version" not in data:
        raise SceneError(f"{path}: not a PEtab problem: it has no 'format_version'")
    return data


def _listed(path: str | Path, data: dict[str, Any], key: str) -> list[str]:
    given = data.get(key)
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise SceneError(f"{path}: '{key}' must name at least one file")
    return names


def _model(path: str | Path, problem: dict[str, Any]) -> str:
    """Return the model file: ``sbml_files``, or ``model_files`` in later editions of version 1."""
    models = problem.get("model_files")
    if isinstance(models, dict) and not problem.get("sbml_files"):
        for model in models.values():
            language = model.get("language") if isinstance(model, dict) else None
            if language != "sbml":
                raise SceneError(
                    f"{path}: the model is in '{language}', but only SBML is supported"
                )
        names = [str(model.get("location")) for model in models.values()]
    else:
        names = _listed(path, problem, "sbml_files")
    if len(names) != 1:
        raise SceneError(f"{path}: {len(names)} models are given, but only one is supported")
    return names[0]


def _existing(path: str | Path, folder: Path, name: str) -> Path:
    found = folder / name
    try:
        is_file = found.is_file()
    except OSError:  # the name is too long for the file system
        is_file = False
    if not is_file:
        raise SceneError(f"{path}: the file '{brief(name)}' does not exist in '{folder}'")
    return found
