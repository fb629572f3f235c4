"""The model description and the build description of an FMU, as XML of FMI 2 or 3."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from cotree.codegen.targets import DOUBLE
from cotree.units import stated_unit
from cotree.version import VERSION

if TYPE_CHECKING:
    from cotree.export.fmi.fmu_variables import FmuVariable, FmuVariables
    from cotree.units import Unit

#: Exponents of units of the standard, in the order of cotree's dimensions; cycles are numbers.
_BASES = ("m", "kg", "s", "A", "K", "mol", "cd", "rad")

_TYPE = {2: "Real", 3: "Float64"}

#: Attributes of interface types that are true.
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

# Structured names of the standard, but for indices of arrays: words, or texts in quotes, with dots.
_WORDS = r"(?:[A-Za-z_][A-Za-z0-9_]*|'[^'\\]+')(?:\.(?:[A-Za-z_][A-Za-z0-9_]*|'[^'\\]+'))*"
_STRUCTURED = re.compile(rf"(?:{_WORDS}|der\({_WORDS}\))\Z")


@dataclass(frozen=True)
class Description:
    """Contents of a model description."""

    version: int  # 2 or 3
    kinds: tuple[str, ...]  # ``ModelExchange``, ``CoSimulation``
    name: str  # name of the model
    identifier: str  # its name in C and of libraries
    token: str  # identifies description and library
    variables: FmuVariables
    #: Of the default experiment.
    t_end: float
    rtol: float
    step: float  # its interval of communication, [s]
    sources: tuple[str, ...]  # names of the ``.c`` files

    def model_description(self) -> str:
        """Write ``modelDescription.xml``."""
        is_new = self.version == 3
        root = ElementTree.Element(
            "fmiModelDescription",
            {
                "fmiVersion": "3.0" if is_new else "2.0",
                "modelName": self.name,
                ("instantiationToken" if is_new else "guid"): self.token,
                "generationTool": f"cotree {VERSION}",
                # Importers show the parts as a tree.
                "variableNamingConvention": "structured" if self._is_structured() else "flat",
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
        ElementTree.SubElement(
            root,
            "DefaultExperiment",
            startTime="0",
            stopTime=_number(self.t_end),
            tolerance=_number(self.rtol),
            stepSize=_number(self.step),
        )
        listed = ElementTree.SubElement(root, "ModelVariables")
        for variable in self.variables.all:
            self._add_variable(listed, variable)
        self._add_structure(root)
        return xml_text(root)

    def _is_structured(self) -> bool:
        return all(_STRUCTURED.match(variable.name) for variable in self.variables.all)

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
            _add_unit(parent, name, unit)

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
            # FMI 3 names a value reference; FMI 2 an index from one, and all are listed in order.
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
        # The knowns of FMI 2 are inputs, states and time, later on without parameters.
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
        self,
        parent: ElementTree.Element,
        tag: str,
        reference: int,
        depends: tuple[int, ...] | None,
    ) -> None:
        shift, name = (1, "index") if self.version == 2 else (0, "valueReference")
        given = {name: str(reference + shift)}
        if depends is not None:
            given["dependencies"] = " ".join(str(i + shift) for i in depends)
        ElementTree.SubElement(parent, tag, given)


def _without(depends: tuple[int, ...] | None, fixed: set[int]) -> tuple[int, ...] | None:
    return None if depends is None else tuple(i for i in depends if i not in fixed)


def _add_unit(parent: ElementTree.Element, name: str, unit: Unit) -> None:
    element = ElementTree.SubElement(parent, "Unit", name=name)
    powers = unit.dimension[: len(_BASES)]
    if any(power != int(power) for power in powers):
        return  # the standard has whole exponents only
    given = {base: str(int(power)) for base, power in zip(_BASES, powers, strict=True) if power}
    if unit.factor != 1:
        given["factor"] = _number(float(unit.factor))
    if unit.offset != 0:
        given["offset"] = _number(float(unit.offset))
    ElementTree.SubElement(element, "BaseUnit", given)


def _number(value: float) -> str:
    return DOUBLE.literal(value).removesuffix(".0")


def xml_text(root: ElementTree.Element) -> str:
    """Return the text of an XML file."""
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'
