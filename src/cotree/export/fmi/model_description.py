"""The model description and the build description of an FMU, as XML of FMI 2 or 3.

Value references number the variables of consecutive blocks, in the order of ``enum fmu_block`` of
``cotree_fmu.h``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from itertools import chain, count
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from cotree.codegen.targets import DOUBLE
from cotree.equations import Quantity
from cotree.errors import CodegenError
from cotree.units import stated_unit, unit_text
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.export.fmi.fmu_sources import FmuKernels
    from cotree.program.layout import Layout


#: Exponents of base units in FMI, in the order of cotree's dimensions; FMI has no cycles.
_BASES = ("m", "kg", "s", "A", "K", "mol", "cd", "rad")

_TYPE = {2: "Real", 3: "Float64"}

#: Capability flags of interface types that are true.
_CAPABILITIES = {
    2: ("canGetAndSetFMUstate", "canSerializeFMUstate", "providesDirectionalDerivative"),
    3: (
        "canGetAndSetFMUState",
        "canSerializeFMUState",
        "providesDirectionalDerivatives",
        "providesAdjointDerivatives",
    ),
}
_CAPABILITIES_OF_KINDS = {
    ("ModelExchange", 2): (),
    ("ModelExchange", 3): ("needsCompletedIntegratorStep",),
    ("CoSimulation", 2): ("canHandleVariableCommunicationStepSize",),
    ("CoSimulation", 3): ("canHandleVariableCommunicationStepSize", "mightReturnEarlyFromDoStep"),
}

# Structured names of the standard, without array indices: words or quoted texts between dots.
_WORDS = r"(?:[A-Za-z_][A-Za-z0-9_]*|'[^'\\]+')(?:\.(?:[A-Za-z_][A-Za-z0-9_]*|'[^'\\]+'))*"
_STRUCTURED = re.compile(rf"(?:{_WORDS}|der\({_WORDS}\))\Z")


@dataclass(frozen=True)
class Description:
    """Contents of a model description."""

    version: int  # version of FMI, 2 or 3
    kinds: tuple[str, ...]  # interface types: ``ModelExchange``, ``CoSimulation``
    name: str  # name of the model
    identifier: str  # name of the C functions and the library
    token: str  # instantiation token (FMI 2: GUID), which ties the library to the description
    variables: FmuVariables
    #: End time, tolerance and step of the default experiment.
    t_end: float
    rtol: float
    step: float  # communication interval, [s]
    sources: tuple[str, ...]  # names of the C source files

    def model_description(self) -> str:
        """Write ``modelDescription.xml``."""
        is_new = self.version == 3
        is_structured = all(_STRUCTURED.match(variable.name) for variable in self.variables.all)
        root = ElementTree.Element(
            "fmiModelDescription",
            {
                "fmiVersion": "3.0" if is_new else "2.0",
                "modelName": self.name,
                ("instantiationToken" if is_new else "guid"): self.token,
                "generationTool": f"cotree {VERSION}",
                # Importers show the parts as a tree.
                "variableNamingConvention": "structured" if is_structured else "flat",
            },
        )
        if not is_new:
            root.set("numberOfEventIndicators", str(len(self.variables.indicators)))
        for kind in self.kinds:
            self._add_kind(root, kind)
        self._add_units(root)
        categories = ElementTree.SubElement(root, "LogCategories")
        for name, about in (
            ("logEvents", "events that were applied"),
            ("logStatusDiscard", "why values cannot be computed"),
            ("logStatusError", "why a call is refused"),
        ):
            ElementTree.SubElement(categories, "Category", name=name, description=about)
        numbers = {"stopTime": self.t_end, "tolerance": self.rtol, "stepSize": self.step}
        given = {name: _number(value) for name, value in numbers.items()}
        ElementTree.SubElement(root, "DefaultExperiment", {"startTime": "0", **given})
        listed = ElementTree.SubElement(root, "ModelVariables")
        for variable in self.variables.all:
            self._add_variable(listed, variable)
        self._add_structure(root)
        return xml_text(root)

    def build_description(self) -> str:
        """Write ``buildDescription.xml`` of FMI 3."""
        root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
        own = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=self.identifier)
        files = ElementTree.SubElement(own, "SourceFileSet", language="C99")
        for name in self.sources:
            ElementTree.SubElement(files, "SourceFile", name=name)
        ElementTree.SubElement(own, "Library", name="m")
        return xml_text(root)

    def _add_kind(self, root: ElementTree.Element, kind: str) -> None:
        given = {"modelIdentifier": self.identifier}
        given |= dict.fromkeys(_CAPABILITIES[self.version], "true")
        given |= dict.fromkeys(_CAPABILITIES_OF_KINDS[kind, self.version], "true")
        element = ElementTree.SubElement(root, kind, given)
        if self.version == 2:
            files = ElementTree.SubElement(element, "SourceFiles")
            for source in self.sources:
                ElementTree.SubElement(files, "File", name=source)

    def _add_units(self, root: ElementTree.Element) -> None:
        units = {v.unit: unit for v in self.variables.all if (unit := stated_unit(v.unit))}
        if not units:
            return
        parent = ElementTree.SubElement(root, "UnitDefinitions")
        for name, unit in sorted(units.items()):
            element = ElementTree.SubElement(parent, "Unit", name=name)
            powers = dict(zip(_BASES, unit.dimension, strict=False))
            if any(power != int(power) for power in powers.values()):
                continue  # the standard allows only integer exponents
            given = {base: str(int(power)) for base, power in powers.items() if power}
            if unit.factor != 1:
                given["factor"] = _number(float(unit.factor))
            if unit.offset != 0:
                given["offset"] = _number(float(unit.offset))
            ElementTree.SubElement(element, "BaseUnit", given)

    def _add_variable(self, parent: ElementTree.Element, variable: FmuVariable) -> None:
        given = {"name": variable.name, "valueReference": str(variable.reference)}
        if variable.doc:
            given["description"] = variable.doc
        given |= {"causality": variable.causality, "variability": variable.variability}
        own: dict[str, str] = {}
        if variable.initial:
            given["initial"] = variable.initial
        if stated_unit(variable.unit):
            own["unit"] = variable.unit
        if variable.derivative_of is not None:
            # FMI 3 refers to a variable by its value reference, FMI 2 by its index, counted from
            # one; all are listed in order of their value references.
            place = variable.derivative_of + (1 if self.version == 2 else 0)
            own["derivative"] = str(place)
        if variable.is_reset and "ModelExchange" in self.kinds:
            own["reinit"] = "true"
        if variable.start is not None:
            own["start"] = _number(variable.start)
        if self.version == 3:
            ElementTree.SubElement(parent, _TYPE[3], given | own)
        else:
            scalar = ElementTree.SubElement(parent, "ScalarVariable", given)
            ElementTree.SubElement(scalar, _TYPE[2], own)

    def _add_structure(self, root: ElementTree.Element) -> None:
        variables = self.variables
        structure = ElementTree.SubElement(root, "ModelStructure")
        initial = [
            *(row for row in variables.reported),
            *(row for row in variables.states[: len(variables.rates)] if row.initial == "approx"),
            *variables.rates,
        ]
        if self.version == 3:
            for tag, rows in (
                ("Output", variables.reported),
                ("ContinuousStateDerivative", variables.rates),
            ):
                for row in rows:
                    self._add_unknown(structure, tag, row.reference, row.depends)
            for row in initial:
                self._add_unknown(structure, "InitialUnknown", row.reference, row.depends_at_start)
            for row in variables.indicators:
                self._add_unknown(structure, "EventIndicator", row.reference, row.depends)
            return
        # In FMI 2, the knowns are inputs, states and time; parameters are omitted after the start.
        fixed = {row.reference for row in variables.parameters}
        initial.sort(key=lambda row: row.reference)
        for tag, found in (
            ("Outputs", [(r.reference, _without(r.depends, fixed)) for r in variables.reported]),
            ("Derivatives", [(r.reference, _without(r.depends, fixed)) for r in variables.rates]),
            ("InitialUnknowns", [(r.reference, r.depends_at_start) for r in initial]),
        ):
            listed = ElementTree.SubElement(structure, tag) if found else structure
            for reference, depends in found:
                self._add_unknown(listed, "Unknown", reference, depends)

    def _add_unknown(
        self, parent: ElementTree.Element, tag: str, reference: int, depends: tuple[int, ...] | None
    ) -> None:
        shift, name = (1, "index") if self.version == 2 else (0, "valueReference")
        given = {name: str(reference + shift)}
        if depends is not None:
            given["dependencies"] = " ".join(str(i + shift) for i in depends)
        ElementTree.SubElement(parent, tag, given)


def _without(depends: tuple[int, ...] | None, fixed: set[int]) -> tuple[int, ...] | None:
    return None if depends is None else tuple(i for i in depends if i not in fixed)


def _number(value: float) -> str:
    return DOUBLE.literal(value).removesuffix(".0")


def xml_text(root: ElementTree.Element) -> str:
    """Return the text of an XML file."""
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'


@dataclass(frozen=True)
class FmuVariable:
    """A variable of an FMU, as the model description lists it."""

    reference: int  # value reference of the variable
    #: Name of the variable, unit in the spelling of cotree, and meaning.
    name: str
    unit: str
    doc: str
    #: Attributes of the standard; ``initial`` is empty if none is required.
    causality: str = "local"
    variability: str = "continuous"
    initial: str = "calculated"
    start: float | None = None  # start value of the variable, if it has one
    derivative_of: int | None = None  # for a derivative: value reference of its state
    is_reset: bool = False  # whether events may set the variable
    #: Value references of the knowns that determine the variable, after and during initialization.
    depends: tuple[int, ...] | None = None
    depends_at_start: tuple[int, ...] | None = None


@dataclass(frozen=True)
class FmuVariables:
    """All variables, by block; ``n_rates`` states have rates."""

    time: FmuVariable  # the independent variable, time
    #: The blocks, in order; algebraic unknowns are the last of the states.
    states: tuple[FmuVariable, ...]
    rates: tuple[FmuVariable, ...]
    parameters: tuple[FmuVariable, ...]
    inputs: tuple[FmuVariable, ...]
    signals: tuple[FmuVariable, ...]
    outputs: tuple[FmuVariable, ...]
    indicators: tuple[FmuVariable, ...]
    output_slopes: tuple[FmuVariable, ...] = ()
    state_slopes: tuple[FmuVariable, ...] = ()

    @property
    def all(self) -> list[FmuVariable]:
        """Every variable in the order of value references."""
        blocks = (getattr(self, row.name) for row in fields(self)[1:])
        return [self.time, *chain.from_iterable(blocks)]

    @property
    def reported(self) -> list[FmuVariable]:
        """The variables whose causality is output."""
        return [*self.outputs, *self.output_slopes]


_PARTS = re.compile(r"((?:[A-Za-z_][A-Za-z0-9_]*\.)*)(.*)", re.DOTALL)


class VariableBlocks:
    """Builds the blocks of variables, with consecutive value references.

    ``outside`` contains the indices of the inputs that the importer sets. Raises CodegenError if
    the scene is too large for value references.
    """

    def __init__(
        self, layout: Layout, kernels: FmuKernels, outside: Sequence[int], has_sensitivities: bool
    ) -> None:
        self.layout, self.kernels, self.outside = layout, kernels, outside
        self.signals = [i for i in range(len(layout.inputs)) if i not in outside]
        n_sensitivities = len(layout.sensitivities) if has_sensitivities else 0
        self.n, self.n_rates = len(layout.states), len(layout.states) - layout.n_algebraic
        n_y, m = len(layout.outputs), n_sensitivities
        counts = [1, self.n, self.n_rates, len(layout.parameters), len(outside), len(self.signals)]
        counts += [n_y, len(layout.events), n_y * m, self.n * m]
        self.firsts = [sum(counts[:i]) for i in range(len(counts) + 1)]
        if self.firsts[-1] > 2**31 - 1:
            raise CodegenError(
                "the scene has too many variables for an FMU: compile fewer sensitivities or "
                "outputs"
            )
        self.given = {"time"}
        # Names of the scene have priority; a derived name that is taken gets a number.
        named = (layout.parameters, layout.inputs, layout.outputs, layout.states)
        self.own = [[self._named(row.name) for row in rows] for rows in named]
        columns = kernels.partials.columns_of()
        self.needed = self._closed(columns)

    def _named(self, name: str) -> str:
        """Return a name, with a number appended if it is taken."""
        numbers = chain([name], (f"{name}_{n}" for n in count(2)))
        found = next(one for one in numbers if one not in self.given)
        self.given.add(found)
        return found

    def _closed(self, columns: list[set[int]]) -> list[set[int]]:
        """Replace algebraic unknowns among the columns of each row by their arguments."""
        algebraic = range(self.n_rates, self.n)
        if not algebraic:
            return columns
        # Unknowns that occur in common residuals form a group, and may depend on all its arguments.
        group = {i: {i} for i in algebraic}
        for i in algebraic:
            merged = set().union(*(group[j] for j in columns[i] if j in group), group[i])
            for j in merged:
                group[j] = merged
        known = {
            i: {c for row in group[i] for c in columns[row] if c not in group} for i in algebraic
        }
        found = []
        for row in columns:
            direct = {c for c in row if c not in group}
            found.append(direct.union(*(known[c] for c in row if c in group)))
        self.known = known
        return found

    def _reference(self, column: int) -> int:
        n_outside, n_p = len(self.outside), len(self.layout.parameters)
        if column < self.n:
            return self.firsts[1] + column
        column -= self.n
        if column < n_outside:
            return self.firsts[4] + column
        column -= n_outside
        return self.firsts[3] + column if column < n_p else 0

    def _needs(self, row: int) -> tuple[int, ...]:
        return tuple(sorted({self._reference(c) for c in self.needed[row]}))

    def listed(
        self, input_values: Sequence[float], start: Sequence[float], *, is_found: bool
    ) -> FmuVariables:
        """List the variables; ``input_values`` and ``start`` are start values.

        ``is_found``: conditions determine the start.
        """
        layout, firsts = self.layout, self.firsts
        self._find_start(is_found)
        states = [self._state(i, start[i]) for i in range(self.n)]
        rates = [self._rate(i) for i in range(self.n_rates)]
        parameters = [
            FmuVariable(
                firsts[3] + i, self.own[0][i], row.unit, row.doc, "parameter", "tunable", "exact", v
            )
            for i, (row, v) in enumerate(
                zip(layout.parameters, layout.parameter_values, strict=True)
            )
        ]
        inputs = [
            FmuVariable(
                firsts[4] + i, self.own[1][place], layout.inputs[place].unit,
                layout.inputs[place].doc, "input", initial="", start=input_values[i],
            )
            for i, place in enumerate(self.outside)
        ]  # fmt: skip
        events = [f"{_quoted(row.name)}.indicator" for row in layout.events]
        meanings = [Quantity("", "", f"function of event {row.name}") for row in layout.events]
        first = self.n
        outputs = self._calculated(6, first, self.own[2], layout.outputs, "output")
        first += len(outputs)
        indicators = self._calculated(7, first, map(self._named, events), meanings)
        first += len(indicators)
        names = [self.own[1][i] for i in self.signals]
        signals = self._calculated(5, first, names, [layout.inputs[i] for i in self.signals])
        time = FmuVariable(0, "time", "s", "", "independent", initial="")
        blocks = tuple(states), tuple(rates), tuple(parameters), tuple(inputs)
        return FmuVariables(time, *blocks, signals, outputs, indicators, *self._slopes())

    def _find_start(self, is_found: bool) -> None:
        """Set the knowns on which each state depends at the start."""
        layout, n_p = self.layout, len(self.layout.parameters)
        own = [set(row) for row in self.kernels.initial.columns_of()] or [set()] * self.n
        everything = {self.firsts[3] + j for j in range(n_p)}
        everything |= {self.firsts[4] + j for j in range(len(self.outside))}
        # If constraints determine the start, it may depend on all prescribed values.
        is_tied = bool(layout.constraints or layout.start_rows)
        self.of_state: list[tuple[int, ...] | None] = []
        for i in range(self.n_rates):
            depends = {self.firsts[3] + j for j in own[i]}
            if is_tied and not layout.given[i]:
                depends = everything
            elif is_found and not layout.given[i]:
                depends = set()  # the start was computed, so it depends on no variable
            self.of_state.append(tuple(sorted(depends)) if depends else None)
        exact = {self.firsts[1] + i for i, d in enumerate(self.of_state) if d is None}
        for i, depends_on in enumerate(self.of_state):
            if depends_on is not None and is_tied and not layout.given[i]:
                self.of_state[i] = tuple(sorted({*depends_on, *exact}))

    def _at_start(self, references: Iterable[int]) -> tuple[int, ...]:
        """Replace states that are not knowns of the initialization by their arguments."""
        found: set[int] = set()
        for reference in references:
            i = reference - self.firsts[1]
            depends = self.of_state[i] if 0 <= i < self.n_rates else None
            found |= {reference} if depends is None else set(depends)
        return tuple(sorted(found))

    def _state(self, i: int, start: float) -> FmuVariable:
        layout, reference = self.layout, self.firsts[1] + i
        row = layout.states[i]
        name, doc = self.own[3][i], row.doc
        if i >= self.n_rates:
            needs = tuple(sorted({self._reference(c) for c in self.known[i]}))
            return FmuVariable(
                reference, name, row.unit, doc or "an algebraic unknown",
                depends=needs, depends_at_start=self._at_start(needs),
            )  # fmt: skip
        depends = self.of_state[i]
        targets = {target for event in layout.events for target in event.targets}
        return FmuVariable(
            reference,
            name,
            row.unit,
            doc,
            initial="exact" if depends is None else "approx",
            start=start,
            is_reset=bool(layout.constraints) or i in targets,
            depends_at_start=depends,
        )

    def _rate(self, i: int) -> FmuVariable:
        row, needs = self.layout.states[i], self._needs(i)
        unit = _over(row.unit, "s")
        return FmuVariable(
            self.firsts[2] + i, self._named(f"der({self.own[3][i]})"), unit, "",
            derivative_of=self.firsts[1] + i, depends=needs, depends_at_start=self._at_start(needs),
        )  # fmt: skip

    def _calculated(
        self,
        block: int,
        first: int,
        names: Iterable[str],
        rows: Sequence[Quantity],
        causality: str = "local",
    ) -> tuple[FmuVariable, ...]:
        """Return a block of calculated variables; ``first`` is the row of the first variable."""
        needs = [self._needs(first + i) for i in range(len(rows))]
        return tuple(
            FmuVariable(
                self.firsts[block] + i, name, row.unit, row.doc, causality,
                depends=needs[i], depends_at_start=self._at_start(needs[i]),
            )
            for i, (name, row) in enumerate(zip(names, rows, strict=True))
        )  # fmt: skip

    def _slopes(self) -> tuple[tuple[FmuVariable, ...], tuple[FmuVariable, ...]]:
        layout, found = self.layout, []
        for first, last, rows, names, causality in (
            (self.firsts[8], self.firsts[9], layout.outputs, self.own[2], "output"),
            (self.firsts[9], self.firsts[10], layout.states, self.own[3], "local"),
        ):
            wanted = layout.sensitivities if last > first else ()
            pairs = [(j, i) for j in range(len(wanted)) for i in range(len(rows))]
            found.append(
                tuple(
                    FmuVariable(
                        first + place,
                        self._named(f"d({names[i]})/d({wanted[j]})"),
                        _over(rows[i].unit, layout.units.get(wanted[j], "")),
                        f"sensitivity of {names[i]} to {wanted[j]}",
                        causality,
                    )
                    for place, (j, i) in enumerate(pairs)
                )
            )
        return found[0], found[1]


def _quoted(name: str) -> str:
    """Quote the last part of an event's name if it is not an identifier, for structured names."""
    parts, own = _PARTS.match(name).groups()  # type: ignore[union-attr]  # it matches any text
    return name if own.isidentifier() else f"{parts}'{own}'"


def _over(unit: str, other: str) -> str:
    """Return a quotient of units; empty if one has no dimension."""
    top, below = stated_unit(unit), stated_unit(other)
    if top is None or below is None:
        return ""
    return unit_text(tuple(a - b for a, b in zip(top.dimension, below.dimension, strict=True)))
