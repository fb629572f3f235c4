"""Sensitivity graphs G2, G3, ...: the formulation run again over differentiated variables.

In: the first graph, solved for its through and across variables. Out: one
:class:`~cotree.equations.Derivative` for each direction. Jacobian columns, parameter and
initial-value sensitivities differ in their seed only.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.equations import Derivative, Equations, Quantity
from cotree.errors import ParameterError, nearest
from cotree.formulation.outputs import output_seed
from cotree.sensitivity.across import move_tangent
from cotree.sensitivity.seed import Seed, Support
from cotree.sensitivity.through import balance_tangent

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.first_graph import FirstGraph


def differentiate(
    first: FirstGraph, name: str, symbols: Mapping[Node, Node], support: Support
) -> Derivative:
    """Run the formulation over one sensitivity graph.

    Parameters
    ----------
    first : FirstGraph
        The first graph.
    name : str
        Name of the direction.
    symbols : mapping of Node to Node
        Tangent of each symbol that changes along it.
    support : Support
        Shared by all directions.
    """
    dag = first.system.dag
    seed = Seed(dag, symbols, support)
    moved = move_tangent(first.motion, seed)
    residual = balance_tangent(moved, first.loads, first.across, first.balance, first.unknowns)
    with dag.labelled("derivatives of rates and outputs"):
        of_unknowns = dict(zip(first.unknowns, unknown_tangents(first), strict=True))
        rates = tangents(first.rates, {**symbols, **of_unknowns})
        across = output_seed(moved, first.outputs)
        outputs = tangents(first.outputs.values, {**symbols, **across})
        initial = tangents([state.initial for state in first.states], symbols)
    return Derivative(
        name,
        dict(symbols),
        tuple(-row for row in residual),
        tuple(rates),
        tuple(outputs),
        tuple(initial),
    )


def state_columns(first: FirstGraph, support: Support) -> tuple[Derivative, ...]:
    """Differentiate along each state: the columns of the Jacobian."""
    one = first.system.dag.one
    return tuple(
        differentiate(first, state.name, {state.symbol: one}, support) for state in first.states
    )


def form_derivatives(
    first: FirstGraph, wanted: Sequence[str], support: Support | None = None
) -> tuple[Derivative, ...]:
    """Differentiate along parameters or initial values, states taken along.

    Parameters
    ----------
    first : FirstGraph
        The first graph.
    wanted : sequence of str
        Names of parameters, or of states whose initial value is meant.
    support : Support, optional
        Shared with other directions.

    Returns
    -------
    tuple of Derivative
        In the order of ``wanted``. The sensitivity of state i to number j is the symbol
        ``("s", j * n_states + i)``.

    Raises
    ------
    ParameterError
        If a name is neither, is not tunable, or occurs twice.
    """
    _check_wanted(first, wanted)
    dag, n = first.system.dag, len(first.states)
    support = support or Support()
    found = []
    for j, name in enumerate(wanted):
        symbols = {state.symbol: dag.symbol("s", j * n + i) for i, state in enumerate(first.states)}
        if name in first.system.parameters:
            symbols |= _of_parameter(first, first.system.parameters[name])
            found.append(differentiate(first, name, symbols, support))
        else:
            found.append(_initial_value(differentiate(first, name, symbols, support), first))
    return tuple(found)


def _of_parameter(first: FirstGraph, parameter: Node) -> dict[Node, Node]:
    """Seed a parameter, and the scene's inputs that depend on it."""
    system = first.system
    seed = {parameter: system.dag.one}
    along = tangents(system.input_values, seed)
    inputs = zip(system.inputs.values(), along, strict=True)
    return seed | {symbol: tangent for symbol, tangent in inputs if not tangent.is_zero}


def _initial_value(direction: Derivative, first: FirstGraph) -> Derivative:
    """Start a direction with one in its own state and zero elsewhere."""
    dag = first.system.dag
    initial = tuple(dag.one if state.name == direction.name else dag.zero for state in first.states)
    return replace(direction, initial=initial)


def unknown_tangents(first: FirstGraph) -> tuple[Node, ...]:
    """Give the symbols of the derivatives of the unknowns."""
    dag = first.system.dag
    return tuple(dag.symbol("dw", i) for i in range(len(first.unknowns)))


def form_equations(first: FirstGraph, sensitivities: Sequence[str]) -> Equations:
    """Add the sensitivity graphs to the first graph.

    Parameters
    ----------
    first : FirstGraph
        The first graph.
    sensitivities : sequence of str
        Parameters, or states whose initial value is meant.

    Raises
    ------
    ParameterError
        If a name is neither, is not tunable, or occurs twice.
    """
    scene, system = first.scene, first.system
    tunable = {n: symbol for n, symbol in system.parameters.items() if symbol.op == "symbol"}
    support = Support()
    parameters = [scene.parameters[name] for name in tunable]
    return Equations(
        name=scene.name,
        dag=system.dag,
        states=first.states,
        parameters=tuple(Quantity(p.name, p.unit, p.doc) for p in parameters),
        inputs=tuple(Quantity(row.name, row.unit, row.doc) for row in scene.inputs.values()),
        outputs=tuple(Quantity(name, output_unit(first, name)) for name in scene.outputs),
        parameter_values=tuple(p.value for p in parameters),
        input_symbols=tuple(system.inputs.values()),
        input_values=system.input_values,
        unknowns=first.unknowns,
        unknown_tangents=unknown_tangents(first),
        matrix=first.matrix,
        forcing=first.forcing,
        is_safe=first.is_safe,
        rates=first.rates,
        balances=first.balance.residual,
        output_values=first.outputs.values,
        sensitivities=form_derivatives(first, sensitivities, support),
        columns=state_columns(first, support),
        guards=first.guards,
    )


def output_unit(first: FirstGraph, name: str) -> str:
    """Give the unit of an output that is one coordinate or node variable; else nothing."""
    text = first.scene.outputs[name].text.strip()
    for state in first.states:
        if state.name == text:
            return state.unit
    variable = text.partition(".")[2]
    return {"x": "m", "y": "m", "z": "m", "vx": "m/s", "vy": "m/s", "vz": "m/s"}.get(variable, "")


def _check_wanted(first: FirstGraph, wanted: Sequence[str]) -> None:
    """Refuse names that nothing can have a sensitivity to."""
    tunable = [n for n, symbol in first.system.parameters.items() if symbol.op == "symbol"]
    states = [state.name for state in first.states]
    for name, times in Counter(wanted).items():
        if times > 1:
            raise ParameterError(f"the sensitivity to '{name}' is asked for twice")
        if name in tunable or name in states:
            continue
        if name in first.scene.parameters:
            raise ParameterError(
                f"parameter '{name}' is not tunable, so nothing has a sensitivity to it: "
                "declare it tunable"
            )
        raise ParameterError(
            f"'{name}' is neither a parameter nor a state{nearest(name, [*tunable, *states])}"
        )
