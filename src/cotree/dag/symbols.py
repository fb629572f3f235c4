"""Kinds of symbols: each stands for one thing, which its number counts.

Those of :data:`ARGUMENT_OF` are what kernels are given. The others stand for what is not known yet
when something is formed, and are replaced later.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.traverse import symbols_in

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.dag.nodes import Node

TIME = "t"
STATE = "x"
INPUT = "u"
PARAMETER = "p"
#: Derivative of state i by parameter or initial value j, at j n + i for n states.
SENSITIVITY = "s"
#: The same among those that do not vanish, one after another.
PACKED_SENSITIVITY = "packed"
#: Rate of a state, in derivatives along the motion.
STATE_RATE = "rate"
#: A direction of the states, along which a kernel differentiates.
DIRECTION = "v"
#: The piece that a step holds of something with corners, zero for none: a sign, or the number of a
#: piece of a table. Kernels read it among the prepared values.
PIECE = "piece"

#: An end of the range of a quantity, or of its rate, over a part of a step.
RANGE = "range"

#: The argument of a kernel that holds the values of each kind.
ARGUMENT_OF = {
    TIME: "t",
    STATE: "x",
    INPUT: "u",
    PARAMETER: "p",
    SENSITIVITY: "s",
    PACKED_SENSITIVITY: "s",
    STATE_RATE: "s",
    RANGE: "s",
    DIRECTION: "v",
    PIECE: "k",
}

#: Change of a state, and of the parameter of sensitivity j, along any direction in common.
STATE_CHANGE = "dx"
PARAMETER_CHANGE = "dp"
#: Change of an input, and of any tunable parameter, along a direction of a linearisation.
INPUT_CHANGE = "du"
TUNED_CHANGE = "dtuned"
#: The direct change by a parameter, at constant states, along that direction.
SOURCE = "source"
#: An acceleration or a multiplier, and its derivative along a direction.
UNKNOWN = "w"
UNKNOWN_CHANGE = "dw"
#: An entry of a right-hand side, or a result, that a map or a pattern is formed for.
ENTRY = "own"
#: An argument of a law.
ARGUMENT = "argument"
#: Newton's step of an algebraic unknown.
STEP = "step"
#: An across variable that a field names.
MEASURED = "measured"
#: Values of a map that all columns share, and those of one column.
SHARED = "shared"
COLUMN = "column"
#: Change of what one column of a map is given, or weight of what it gives.
CHANGE = "change"


def kinds_in(roots: Iterable[Node]) -> set[str]:
    """List the kinds of symbols that some values depend on."""
    return {symbol.data[0] for symbol in symbols_in(roots)}
