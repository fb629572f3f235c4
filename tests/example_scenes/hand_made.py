"""Models whose equations are written down by hand, with algebraic unknowns at will."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree import Model, Scene
from cotree.build import BuildOptions
from cotree.dag.derivative import tangents
from cotree.dag.lookup import LinearTable
from cotree.dag.multi_output import table
from cotree.dag.nodes import STATE_RATE, Dag
from cotree.equations import ConstraintSet, Derivative, Equations, Quantity, State
from cotree.model.linearize import Linearizer
from cotree.model.loading import load_model
from cotree.pipeline import Formed, generate, text_of
from cotree.spec import BuildSpec

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.dag.nodes import Node

NO_CONSTRAINTS = ConstraintSet((), (), (), (), (), (), (), (), (), (), ())


@dataclass(frozen=True)
class Made:
    """Equations by hand.

    ``states`` maps names to initial values, numbers or names of parameters; those in ``algebraic``
    come last. ``rates`` takes every symbol by name, "t" too, and gives M y'.
    """

    name: str
    states: Mapping[str, float | str]
    algebraic: Mapping[str, float | str]
    parameters: Mapping[str, float]
    rates: Callable[[Mapping[str, Node]], Sequence[Node]]
    outputs: Callable[[Mapping[str, Node]], Mapping[str, Node]] = lambda v: {}
    inputs: Mapping[str, Callable[[Mapping[str, Node]], Node] | LinearTable] | None = None

    def equations(self, sensitivities: Sequence[str] = ()) -> Equations:
        return _equations(self, sensitivities)[0]

    def model(self, sensitivities: Sequence[str] = (), t_end: float = 1.0) -> Model:
        return model_of(*_equations(self, sensitivities), t_end=t_end)


def model_of(
    equations: Equations, input_columns: Sequence[Derivative] = (), t_end: float = 1.0
) -> Model:
    """Compile equations that no scene gives."""
    program, reports = generate(equations)
    text = text_of(program)
    scene = Scene(equations.name)
    scene.simulation(t_end=t_end)
    spec = BuildSpec(scene)
    spec.__dict__["formed"] = Formed(None, (), reports, text, {})
    model = Model(load_model(text, BuildOptions()), spec, {})
    model.__dict__["_linearizer"] = Linearizer(equations, input_columns)
    return model


def _equations(made: Made, wanted: Sequence[str]) -> tuple[Equations, tuple[Derivative, ...]]:
    dag = Dag()
    inputs = made.inputs or {}
    names = [*made.states, *made.algebraic]
    x = {name: dag.symbol("x", i) for i, name in enumerate(names)}
    p = {name: dag.symbol("p", i) for i, name in enumerate(made.parameters)}
    u = {name: dag.symbol("u", i) for i, name in enumerate(inputs)}
    t = dag.symbol("t", 0)
    known = {**x, **p, **u, "t": t}
    input_values = [
        table(dag, value, t)[0] if isinstance(value, LinearTable) else value({**p, "t": t})
        for value in inputs.values()
    ]
    rates = list(made.rates(known))
    outputs = dict(made.outputs(known))
    initial = [
        p[value] if isinstance(value, str) else dag.constant(float(value))
        for value in (*made.states.values(), *made.algebraic.values())
    ]

    def along(name: str, seed: Mapping[Node, Node], start: Sequence[Node]) -> Derivative:
        return Derivative(
            name,
            dict(seed),
            (),
            dict(enumerate(tangents(rates, seed))),
            dict(enumerate(tangents(list(outputs.values()), seed))),
            dict(enumerate(start)),
            (),
            (),
            (),
        )

    directions = []
    for j, name in enumerate(wanted):
        seed = {s: dag.symbol("s", j * len(names) + i) for i, s in enumerate(x.values())}
        start = [dag.one if row == name else dag.zero for row in names]
        if name in p:
            seed[p[name]] = dag.one
            moved = tangents(input_values, {p[name]: dag.one})
            seed |= dict(zip(u.values(), moved, strict=True))
            start = tangents(initial, {p[name]: dag.one})
        directions.append(along(name, seed, start))
    zeros = [dag.zero] * len(names)
    motion = {s: dag.symbol(STATE_RATE, i) for i, s in enumerate(x.values())} | {t: dag.one}
    motion |= dict(zip(u.values(), tangents(input_values, {t: dag.one}), strict=True))
    equations = Equations(
        name=made.name,
        dag=dag,
        states=tuple(
            State(name, "", x[name], first, is_algebraic=name in made.algebraic)
            for name, first in zip(names, initial, strict=True)
        ),
        parameters=tuple(map(Quantity, p)),
        inputs=tuple(map(Quantity, u)),
        outputs=tuple(map(Quantity, outputs)),
        parameter_values=tuple(made.parameters.values()),
        input_symbols=tuple(u.values()),
        input_values=tuple(input_values),
        unknowns=(),
        unknown_tangents=(),
        matrix=(),
        forcing=(),
        is_safe=(),
        holding=(),
        links=(),
        rates=tuple(rates),
        balances=(),
        constraints=NO_CONSTRAINTS,
        output_values=tuple(outputs.values()),
        sensitivities=tuple(directions),
        columns=tuple(along(name, {symbol: dag.one}, zeros) for name, symbol in x.items()),
        guards=(),
        n_network_states=len(made.states),
        motion=along("t", motion, zeros) if made.algebraic else None,
    )
    columns = tuple(along(name, {symbol: dag.one}, zeros) for name, symbol in u.items())
    return equations, columns
