"""Equations for display: governing and sensitivity equations in SymPy, LaTeX and plain text.

They read like the paper's Eq. (8) and (9): inertia terms first, with positive sign, then the rest,
equal to zero. Constraints follow, differentiated until accelerations appear in them.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cotree.dag.nodes import reachable
from cotree.equations import spread
from cotree.export.spelling import (
    acceleration_name,
    joined,
    latex_subscript,
    mathml_printer,
    printer,
    real_symbol,
    spell_multipliers,
    spell_states,
    subscript,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Derivative, Equations

_LARGEST_DENOMINATOR = 10**6
_LARGEST_NUMERATOR = 10**15

#: SymPy functions whose names differ from cotree's.
_SYMPY_NAMES = {"abs": "Abs"}


def to_sympy(nodes: Sequence[Node], symbols: Mapping[Node, Any]) -> list[Any]:
    """Convert nodes to SymPy expressions; nodes in ``symbols`` become its values.

    A node with several results becomes the application of an undefined function: ``table_1(t)``,
    ``solve_1_x_1(...)``, ``name_1(...)``. Raises KeyError if a symbol has no expression.
    """
    known: dict[Node, Any] = {}
    numbers: dict[Any, int] = {}
    for node in reachable(nodes, stop=symbols):
        if node in symbols:
            known[node] = symbols[node]
        elif node.value is not None:
            known[node] = rational(node.value)
        elif node.op == "symbol":
            raise KeyError(f"no SymPy symbol is given for {node!r}")
        elif node.op == "result":
            known[node] = _result(node, [known[arg] for arg in _arguments(node)], numbers)
        # A node with several results has no single expression.
        elif node.op not in _SEVERAL:
            known[node] = _apply(node.op, [known[arg] for arg in node.args])
    return [known[node] for node in nodes]


def rational(value: float) -> Any:
    """Return the simplest rational number that reads back as the same double, or the double.

    >>> rational(1.0 / 12.0), rational(9.81)
    (1/12, 981/100)
    """
    import sympy

    # Write 1/12, not 0.08333333333333333, but only if both are the same double.
    fraction = Fraction(value).limit_denominator(_LARGEST_DENOMINATOR)
    if float(fraction) == value and abs(fraction.numerator) <= _LARGEST_NUMERATOR:
        return sympy.Rational(fraction.numerator, fraction.denominator)
    return sympy.Float(value)


#: Operations that Python operators compute, for numbers and for expressions.
ARITHMETIC: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "pow": lambda a, b: a**b,
}


def _apply(op: str, args: list[Any]) -> Any:
    import sympy

    if op in ARITHMETIC:
        return ARITHMETIC[op](*args)
    if op == "select":
        # The second branch must have the condition True, or SymPy returns nan outside the first.
        condition, accepted, refused = args
        return sympy.Piecewise((accepted, condition >= 0), (refused, True))
    return getattr(sympy, _SYMPY_NAMES.get(op, op))(*args)


def _solve_name(node: Node, i: int) -> str:
    last = "rank" if i == node.data.size else "is_determined"
    return f"x_{i + 1}" if i < node.data.size else last


#: Function names for the results of nodes with several results.
_SEVERAL: dict[str, Callable[[Node, int], str]] = {
    "solve": _solve_name,
    "table": lambda node, i: "slope" if i else "",
    "lookup": lambda node, i: str(node.data.results[i]),
    "call": lambda node, i: str(i + 1),
}


def _arguments(node: Node) -> tuple[Node, ...]:
    """Return the arguments of a result, except those that only affect rank decisions."""
    source = node.args[0]
    if source.op != "solve":
        return source.args
    size = source.data.size
    # The arguments are the coefficients and the right-hand side.
    return source.args[: size * (size + 1)]


def _result(node: Node, args: list[Any], numbers: dict[Any, int]) -> Any:
    """Represent one of several results of a node by an undefined function of its arguments."""
    import sympy

    source = node.args[0]
    # Identify a linear system by its arguments, a table or a function by its data.
    key = (source.op, source if source.op == "solve" else source.data)
    if key not in numbers:
        # Number the functions of each kind from one, in the order of evaluation.
        numbers[key] = 1 + sum(op == source.op for op, _ in numbers)
    own = source.data.name if source.op == "call" else f"{source.op}_{numbers[key]}"
    suffix = _SEVERAL[source.op](source, node.data)
    return sympy.Function(f"{own}_{suffix}" if suffix else own, real=True)(*args)


_WAYS = {-1: "falls through", 0: "passes", 1: "rises through"}


@dataclass(frozen=True)
class SymbolicEvent:
    """An event that occurs when an expression crosses zero.

    Attributes
    ----------
    when : sympy.Expr
        The expression.
    direction : int
        -1 for downwards, 1 for upwards, 0 for both.
    set : mapping of str to sympy.Expr
        New values of states and modes by name, as functions of the values before the event.
    restitution : sympy.Expr or None
        Coefficient of restitution if the event is an impact.
    is_terminal : bool
        Whether it ends a run.
    is_chosen : bool
        Whether the event selects the modes of dry friction and rigid stops together; expressions do
        not set them.
    """

    when: Any
    direction: int
    set: Mapping[str, Any]
    restitution: Any
    is_terminal: bool
    is_chosen: bool = False

    @property
    def is_stop(self) -> bool:
        """Deprecated name of ``is_terminal``."""
        warnings.warn("is_stop is deprecated: use is_terminal", DeprecationWarning, stacklevel=2)
        return self.is_terminal

    def line(self, name: str, spell: Callable[[Any], str], symbols: Mapping[Any, Any]) -> str:
        """Write the event as plain text; ``spell`` writes an expression."""
        # Expressions read the values before the event.
        actions = [f"{symbols[state]} := {spell(value)}" for state, value in self.set.items()]
        if self.is_chosen:
            why = "is chosen with the modes of all friction and stops"
            actions = [f"{symbols[state]} {why}" for state in self.set]
        if self.restitution is not None:
            actions.append(f"an impact with restitution {spell(self.restitution)}")
        if self.is_terminal:
            actions.append("the run ends")
        then = ", ".join(actions) or "it is noted"
        return f"{name}: where {spell(self.when)} {_WAYS[self.direction]} 0, {then}"


def symbolic_events(
    equations: Equations, known: Mapping[Node, Any], states: tuple[str, ...]
) -> dict[str, SymbolicEvent]:
    """Convert the events of equations to SymPy, by name."""
    # Event expressions follow the outputs in ``output_values``.
    first = len(equations.outputs)
    values = dict(enumerate(to_sympy(equations.output_values[first:], known), start=first))
    found = {}
    # An impact sets speeds by its coefficient of restitution, not by expressions.
    for row in equations.events:
        kept = zip(row.kept, row.new_values, strict=True)
        new = {states[target]: values[place] for target, place in kept}
        restitution = None if row.restitution is None else values[row.restitution]
        found[row.name] = SymbolicEvent(
            values[row.watched], row.direction, new, restitution, row.is_terminal, row.part > 0
        )
    return found


#: Name of a value, or names of a state and of the parameter by which it is differentiated.
Key = str | tuple[str, str]

# Largest number of operations of a mass matrix entry that is expanded.
_LARGEST_TIDIED = 40

# Maximum number of lines in ``repr``, and of LaTeX characters that a notebook typesets.
_MOST_LINES, _MOST_SET = 40, 20_000


@dataclass(frozen=True, repr=False)
class SymbolicEquations:
    """Governing and sensitivity equations as SymPy expressions.

    Attributes
    ----------
    governing : tuple of sympy.Eq
        Equations ``... = 0``: one for each speed; one for each constraint, its second time
        derivative, or the first of a constraint on rates; one for each network state and algebraic
        unknown.
    sensitivity : mapping of str to tuple of sympy.Eq
        The equations of the sensitivity graph of each requested parameter (or of each state whose
        initial value is meant).
    states : tuple of str
        Names of the states: coordinates, speeds, then those of networks.
    accelerations : tuple of str
        Names of the rates of the speeds: ``"j1.s_ddot"`` for the rate of ``"j1.s_dot"``, where
        that is the rate of a coordinate ``"j1.s"``, and ``"b.w1_dot"`` for that of any other
        speed, such as the angular velocity ``"b.w1"`` or the velocity ``"b.vx"``.
    multipliers : tuple of str
        Names of the constraints (``"D4.x"``), which are also those of their multipliers.
    rates : tuple of str
        Names of the rates of the networks' states: ``"C1.v_dot"``.
    n_coordinates : int
        Number of coordinates, which come first among the states.
    symbols : mapping of str or (str, str) to sympy.Symbol
        By name: states, accelerations, rates, multipliers (spelt ``lambda_D4_x``), parameters,
        inputs and ``"t"``; the sensitivity of each of the first four by a pair such as
        ``("j1.s_dot", "L")``.
    initial : mapping of str or (str, str) to sympy.Expr
        Initial values of the states and of their sensitivities.
    latex_names : mapping of sympy.Symbol to str
        LaTeX names of states, accelerations, multipliers and their sensitivities.
    events : mapping of str to SymbolicEvent
        The events at zero crossings of expressions, by name.
    """

    governing: tuple[Any, ...]
    sensitivity: Mapping[str, tuple[Any, ...]]
    states: tuple[str, ...]
    accelerations: tuple[str, ...]
    multipliers: tuple[str, ...]
    rates: tuple[str, ...]
    n_coordinates: int
    symbols: Mapping[Key, Any]
    initial: Mapping[Key, Any]
    latex_names: Mapping[Any, str]
    events: Mapping[str, SymbolicEvent]

    def lines(self, name: str | None = None) -> list[str]:
        """Return the governing equations, or those of one sensitivity, as plain text."""
        spell = printer("text", {})
        return [self._line(equation, spell, name) for equation in self._equations(name)]

    def latex(self) -> str:
        """Return all equations as one LaTeX ``align`` environment, the governing ones first."""
        spell = printer("latex", self.latex_names)
        rows = [
            f"  {self._line(equation, spell, name).removesuffix(' = 0')} &= 0"
            for name in (None, *self.sensitivity)
            for equation in self._equations(name)
        ]
        return "\n".join([r"\begin{align}", ", \\\\\n".join(rows) + ".", r"\end{align}"])

    def mathml(self, name: str | None = None) -> list[str]:
        """Return the governing equations, or those of one sensitivity, as MathML elements."""
        spell = mathml_printer(self.latex_names)
        return [
            f'<math display="block">{spell(self._terms(row, name))}<mo>=</mo><mn>0</mn></math>'
            for row in self._equations(name)
        ]

    def event_lines(self) -> list[str]:
        """Return the events as plain text, one line for each."""
        spell = printer("text", {})
        return [event.line(name, spell, self.symbols) for name, event in self.events.items()]

    def __repr__(self) -> str:
        lines = str(self).splitlines()
        hidden = len(lines) - _MOST_LINES
        return "\n".join(lines[:_MOST_LINES] + ([f"… {hidden} more"] if hidden > 0 else []))

    def _repr_latex_(self) -> str | None:
        """Return LaTeX for notebooks, or None for equations that take minutes to typeset."""
        if sum(map(len, map(str, self.governing))) > _MOST_SET:
            return None
        text = self.latex()
        if len(text) > _MOST_SET:
            return None
        # Left-aligned, because wide equations exceed the page.
        text = (
            text.replace("{align}", "{aligned}").replace(" &= 0", " = 0").replace("\n  ", "\n  & ")
        )
        return f"$${text}$$"

    def __str__(self) -> str:
        lines = [line for name in (None, *self.sensitivity) for line in self.lines(name)]
        return "\n".join([*lines, *self.event_lines()])

    def _equations(self, name: str | None) -> tuple[Any, ...]:
        return self.governing if name is None else self.sensitivity[name]

    def _line(self, equation: Any, spell: Callable[[Any], str], name: str | None) -> str:
        """Write an equation with the terms of the highest derivatives first."""
        return f"{joined([spell(term) for term in self._terms(equation, name)])} = 0"

    def _terms(self, equation: Any, name: str | None) -> list[Any]:
        """Return the terms of an equation, those of the highest derivatives first."""
        # As in the paper, the sensitivities, unknowns of Eq. (9), precede the other variables.
        order: list[Any] = []
        n = self.n_coordinates
        highest = (*self.accelerations, *self.rates, *self.multipliers)
        for rows in (highest, self.states[n:], self.states[:n]):
            order += [] if name is None else [self.symbols[row, name] for row in rows]
            order += [self.symbols[row] for row in rows]

        def place(term: Any) -> int:
            found = term.free_symbols
            return next((i for i, symbol in enumerate(order) if symbol in found), len(order))

        return sorted(equation.lhs.as_ordered_terms(), key=place)


def symbolic_equations(equations: Equations) -> SymbolicEquations:
    """Convert governing and sensitivity equations to SymPy.

    >>> from cotree.formulation.first_graph import form_first_graph
    >>> from cotree.scene.description import SceneDescription
    >>> from cotree.scene.graphs import choose_trees, joint_tree, linear_graphs
    >>> from cotree.sensitivity.graphs import form_equations
    >>> scene = SceneDescription("block")
    >>> scene.parameter("m", 2.0)
    >>> scene.parameter("k", 50.0)
    >>> scene.edge("body", "rigid_body", "ground", "A", mass="m")
    >>> scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k")
    >>> tree = joint_tree(scene, choose_trees(scene, linear_graphs(scene), None))
    >>> print(symbolic_equations(form_equations(form_first_graph(scene, tree), ["k"])))
    m*s_ddot + k*s = 0
    m*s_ddot_k + k*s_k + s = 0
    """
    names = SymbolTable.of(equations)
    known = names.known(equations)
    matrix = _matrix(equations, known)
    # Balances determine the rates of coordinates and speeds; they have no separate equations.
    n_speeds = len(names.accelerations)
    n = equations.n_coordinates + n_speeds
    initial: dict[Key, Any] = dict(
        zip(
            names.states,
            to_sympy([state.initial for state in equations.states], known),
            strict=True,
        )
    )
    sensitivity = {}
    for direction in equations.sensitivities:
        name = direction.name
        own = names.known_along(equations, direction)
        along = to_sympy(direction.forcing, known | own)
        zero, n_states = equations.dag.zero, len(names.states)
        rates = to_sympy(spread(direction.rates, n_states, zero)[n:], known | own)
        sensitivity[name] = (
            *_balances(matrix, names.unknowns(name), along, n_speeds),
            *names.network_balances(rates, name),
        )
        values = to_sympy(spread(direction.initial, n_states, zero), known)
        initial |= {(s, name): v for s, v in zip(names.states, values, strict=True)}
    return SymbolicEquations(
        governing=(
            *_balances(matrix, names.unknowns(), to_sympy(equations.forcing, known), n_speeds),
            *names.network_balances(to_sympy(equations.rates[n:], known)),
        ),
        sensitivity=sensitivity,
        states=names.states,
        accelerations=names.accelerations,
        multipliers=names.multipliers,
        rates=names.rates,
        n_coordinates=equations.n_coordinates,
        symbols=names.symbols,
        initial=initial,
        latex_names=names.latex,
        events=symbolic_events(equations, known, names.states),
    )


def _matrix(equations: Equations, known: Mapping[Node, Any]) -> list[list[Any]]:
    """Return the rows of the matrix; those of constraints have the opposite sign."""
    rows = [to_sympy(row, known) for row in equations.matrix]
    # Unknowns are accelerations, then one multiplier for each constraint.
    first, end = equations.n_speeds, equations.n_speeds + len(equations.constraints.rows)
    # The border of the symmetric matrix is -G; change its sign to display G.
    rows[first:end] = [[-entry for entry in row] for row in rows[first:end]]
    return [[_tidied(entry) for entry in row] for row in rows]


def _balances(
    matrix: list[list[Any]], unknowns: list[Any], forcing: list[Any], n_speeds: int
) -> tuple[Any, ...]:
    """Return the equations matrix @ unknowns = forcing, row by row, with zero on the right."""
    import sympy

    totals = []
    for i, (row, b) in enumerate(zip(matrix, forcing, strict=True)):
        pairs = list(zip(row, unknowns, strict=True))
        # Balances are A w - b. The rows of constraints, with the sign changed, are G a + b.
        if i < n_speeds:
            totals.append(sympy.Add(*(a * w for a, w in pairs), -b))
        else:
            # Move a common minus sign of a sum to the front.
            terms = (-(-a * w) if a.could_extract_minus_sign() else a * w for a, w in pairs)
            totals.append(sympy.Add(*terms, b))
    return tuple(sympy.Eq(total, 0, evaluate=False) for total in totals)


def _tidied(entry: Any) -> Any:
    """Expand an entry of the mass matrix if it is small and becomes shorter."""
    import sympy

    size = entry.count_ops()
    if size > _LARGEST_TIDIED:
        return entry
    number, factors = sympy.factor_terms(sympy.expand(entry)).as_coeff_mul()
    # Leave numbers in the sum: m (L^2/3 + r^2/4), not m (4 L^2 + 3 r^2)/12.
    sums = [factor for factor in factors if factor.is_Add][:1]
    others = [factor for factor in factors if factor not in sums]
    if sums:
        others.append(sympy.Add(*[number * term for term in sums[0].args]))
        number = 1
    other = sympy.Mul(number, *others)
    return other if other.count_ops() < size else entry


@dataclass(frozen=True)
class SymbolTable:
    """The SymPy symbols by name, and LaTeX names; ``rates`` are the rates of network states."""

    states: tuple[str, ...]
    accelerations: tuple[str, ...]
    multipliers: tuple[str, ...]
    rates: tuple[str, ...]
    symbols: dict[Key, Any]
    latex: dict[Any, str]
    subscripts: dict[str | None, str]

    @classmethod
    def of(cls, equations: Equations) -> SymbolTable:
        """Build the table for all symbols of the equations."""
        states = tuple(state.name for state in equations.states)
        multipliers = (
            *(row.name for row in equations.constraints.rows),
            *(row.name for row in equations.holding),
        )
        n_speeds = equations.n_speeds
        n = equations.n_coordinates + n_speeds
        coordinates, speeds = states[: equations.n_coordinates], states[n - n_speeds : n]
        accelerations = tuple(acceleration_name(speed, coordinates) for speed in speeds)
        given = [row.name for row in (*equations.parameters, *equations.inputs)]
        # Like angular velocities, network states are not rates of coordinates.
        stored = states[n : n + equations.n_network_states]
        others = states[n + len(stored) :]
        of_states = spell_states((*coordinates, *others), (*speeds, *stored), given)
        spelt = of_states | spell_multipliers(multipliers)
        rates = tuple(acceleration_name(name, ()) for name in stored)
        names = cls(states, accelerations, multipliers, rates, {}, {}, {})
        used = {*given, "t"}
        for name in (*given, "t"):
            names.symbols[name] = real_symbol(name)
        # Names must be unique over all graphs: s_L may be a parameter or a sensitivity of s.
        for along in (None, *(direction.name for direction in equations.sensitivities)):
            mark = names.subscripts[along] = subscript(along, of_states)
            for row, own in spelt.items():
                text = f"{own.text}{mark}"
                while text in used:
                    text += "_"
                used.add(text)
                symbol = real_symbol(text)
                names.symbols[row if along is None else (row, along)] = symbol
                names.latex[symbol] = own.latex(*latex_subscript(along, of_states))
        return names

    def unknowns(self, along: str | None = None) -> list[Any]:
        """Return the symbols of the unknowns, or of their sensitivities to ``along``."""
        rows = (*self.accelerations, *self.multipliers)
        return [self.symbols[row if along is None else (row, along)] for row in rows]

    def known(self, equations: Equations) -> dict[Node, Any]:
        """Map each symbol of the first graph to its SymPy symbol."""
        dag = equations.dag
        known = {state.symbol: self.symbols[state.name] for state in equations.states}
        known |= zip(equations.unknowns, self.unknowns(), strict=True)
        for kind, rows in (("p", equations.parameters), ("u", equations.inputs)):
            known |= {dag.symbol(kind, i): self.symbols[row.name] for i, row in enumerate(rows)}
        known[dag.symbol("t", 0)] = self.symbols["t"]
        return known

    def known_along(self, equations: Equations, direction: Derivative) -> dict[Node, Any]:
        """Map each symbol of one sensitivity graph to its SymPy symbol."""
        tangents = {state.name: direction.seed[state.symbol] for state in equations.states}
        known = {node: self.symbols[name, direction.name] for name, node in tangents.items()}
        return known | dict(
            zip(equations.unknown_tangents, self.unknowns(direction.name), strict=True)
        )

    def network_balances(self, rates: Sequence[Any], along: str | None = None) -> tuple[Any, ...]:
        """Return the network equations, first those of state rates, with zero on the right."""
        import sympy

        own = [self.symbols[row if along is None else (row, along)] for row in self.rates]
        left = own + [sympy.Integer(0)] * (len(rates) - len(own))
        return tuple(
            sympy.Eq(a - b if a != 0 else b, 0, evaluate=False)
            for a, b in zip(left, rates, strict=True)
        )
