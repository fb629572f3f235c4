"""Texts of SBML models for tests."""

from __future__ import annotations

from typing import Any

_HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1">\n'
    '<model id="m">\n'
)


def math_text(formula: str) -> str:
    """Write a formula, as ``V*k*A``, in MathML."""
    import libsbml

    node = libsbml.parseL3Formula(formula)
    assert node is not None, libsbml.getLastParseL3Error()
    written: str = libsbml.writeMathMLToString(node)
    return written.partition("?>")[2].strip()


def model_text(
    parts: str,
    *,
    functions: str = "",
    initials: dict[str, str] | None = None,
    assignments: dict[str, str] | None = None,
    rates: dict[str, str] | None = None,
    reactions: dict[str, tuple[Any, Any, str]] | None = None,
    events: str = "",
) -> str:
    """Write a model of Level 3.

    Parameters
    ----------
    parts : str
        Lists of compartments, species and parameters.
    functions, events : str
        Contents of the lists of functions and of events.
    initials, assignments, rates : dict of str to str
        Formulas by what they determine.
    reactions : dict of str to (reactants, products, formula)
        Reactions; a species stands there as often as it takes part.
    """
    listed = [f"<listOfFunctionDefinitions>{functions}</listOfFunctionDefinitions>"] * bool(
        functions
    )
    listed.append(parts)
    if initials:
        rows = (
            f'<initialAssignment symbol="{id}">{math_text(f)}</initialAssignment>'
            for id, f in initials.items()
        )
        listed.append(f"<listOfInitialAssignments>{''.join(rows)}</listOfInitialAssignments>")
    rules = [
        f'<{kind}Rule variable="{id}">{math_text(f)}</{kind}Rule>'
        for kind, table in (("assignment", assignments), ("rate", rates))
        for id, f in (table or {}).items()
    ]
    listed += [f"<listOfRules>{''.join(rules)}</listOfRules>"] * bool(rules)
    if reactions:
        rows = (_reaction(id, *row) for id, row in reactions.items())
        listed.append(f"<listOfReactions>{''.join(rows)}</listOfReactions>")
    listed += [f"<listOfEvents>{events}</listOfEvents>"] * bool(events)
    return f"{_HEAD}{''.join(listed)}\n</model></sbml>\n"


def _reaction(id: str, reactants: list[str], products: list[str], formula: str) -> str:
    sides = []
    for word, names in (("Reactants", reactants), ("Products", products)):
        rows = "".join(
            f'<speciesReference species="{n}" stoichiometry="1" constant="true"/>' for n in names
        )
        sides.append(f"<listOf{word}>{rows}</listOf{word}>" * bool(names))
    law = f"<kineticLaw>{math_text(formula)}</kineticLaw>"
    return f'<reaction id="{id}" reversible="false" fast="false">{"".join(sides)}{law}</reaction>'


def event_text(
    trigger: str,
    sets: dict[str, str],
    *,
    id: str = "e",
    initial: str = "true",
    persistent: str = "true",
    at_trigger: str = "true",
    more: str = "",
) -> str:
    """Write an event; ``more`` stands after its trigger."""
    rows = "".join(
        f'<eventAssignment variable="{id}">{math_text(f)}</eventAssignment>'
        for id, f in sets.items()
    )
    attributes = f'initialValue="{initial}" persistent="{persistent}"'
    return (
        f'<event id="{id}" useValuesFromTriggerTime="{at_trigger}">'
        f"<trigger {attributes}>{math_text(trigger)}</trigger>"
        f"{more}<listOfEventAssignments>{rows}</listOfEventAssignments></event>"
    )


def function_text(id: str, formula: str) -> str:
    """Write a function definition: ``lambda(x, y, x*y)``."""
    return f'<functionDefinition id="{id}">{math_text(formula)}</functionDefinition>'


def species_text(id: str, *, compartment: str = "V", **attributes: object) -> str:
    """Write a species, a concentration that reactions change where nothing else is said."""
    own: dict[str, object] = {
        "hasOnlySubstanceUnits": "false",
        "boundaryCondition": "false",
        "constant": "false",
        **attributes,
    }
    written = " ".join(f'{key}="{value}"' for key, value in own.items())
    return f'<species id="{id}" compartment="{compartment}" {written}/>'


def parts_text(
    species: list[str],
    parameters: dict[str, float | None],
    *,
    compartments: dict[str, float] | None = None,
    constant: bool = True,
) -> str:
    """Write lists of compartments, species and parameters, which may change unless constant."""
    word = str(constant).lower()
    places = "".join(
        f'<compartment id="{id}" spatialDimensions="3" size="{size}" constant="{word}"/>'
        for id, size in (compartments or {"V": 2.0}).items()
    )
    rows = "".join(
        f'<parameter id="{id}" constant="{word}"'
        + ("/>" if value is None else f' value="{value}"/>')
        for id, value in parameters.items()
    )
    return (
        f"<listOfCompartments>{places}</listOfCompartments>"
        + f"<listOfSpecies>{''.join(species)}</listOfSpecies>" * bool(species)
        + f"<listOfParameters>{rows}</listOfParameters>" * bool(rows)
    )


def whole_text() -> str:
    """Write a model of some of everything."""
    return model_text(
        parts_text(
            [
                species_text("A", initialConcentration=3.0),
                species_text("B", initialAmount=1.0, hasOnlySubstanceUnits="true"),
                species_text("C", initialConcentration=1.0, boundaryCondition="true"),
            ],
            {"k": 0.5, "n": 0.0, "p": None, "x": 1.0},
            constant=False,
        ),
        functions=function_text("f", "lambda(a, b, a*b/(1 + a))"),
        initials={"n": "2*A + k"},
        assignments={"p": "A*C + sin(time)"},
        rates={"x": "-0.1*x"},
        reactions={"R": (["A"], ["B"], "V*k*f(A, p)"), "S": (["B"], [], "piecewise(1, B > 2, B)")},
        events=event_text("A < 1", {"A": "3", "k": "k/2"}),
    )
