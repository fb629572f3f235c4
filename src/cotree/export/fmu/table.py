"""The variables of an FMU as a table, which the model description and the C code follow.

A value reference is a place in consecutive blocks, in the order of ``enum fmu_block`` of
``fmu.h``.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Variable:
    """A variable.

    Attributes
    ----------
    reference : int
        Its value reference.
    name, unit, doc : str
        Its name, unit in the spelling of cotree, and meaning.
    causality, variability : str
        As in the standard.
    initial : str
        ``exact``, ``approx`` or ``calculated``; empty where the standard has none.
    start : float or None
        Its start value, if it has one.
    derivative_of : int or None
        Value reference of the state that it is the derivative of.
    is_reset : bool
        Whether events may set it.
    depends, depends_at_start : tuple of int
        Value references of the knowns that it depends on: later on, and during the initialization.
    """

    reference: int
    name: str
    unit: str
    doc: str
    causality: str
    variability: str
    initial: str = ""
    start: float | None = None
    derivative_of: int | None = None
    is_reset: bool = False
    depends: tuple[int, ...] | None = None
    depends_at_start: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Variables:
    """All variables, by block.

    Attributes
    ----------
    time : Variable
        The independent variable.
    states, rates, parameters, inputs, signals, outputs, indicators, output_slopes, state_slopes
        The blocks, in order; algebraic unknowns are the last of the states.
    n_rates : int
        Number of states that have rates.
    """

    time: Variable
    states: tuple[Variable, ...]
    rates: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    signals: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    indicators: tuple[Variable, ...]
    output_slopes: tuple[Variable, ...] = field(default=())
    state_slopes: tuple[Variable, ...] = field(default=())

    @property
    def all(self) -> list[Variable]:
        """Every variable in the order of value references."""
        return [
            self.time,
            *self.states,
            *self.rates,
            *self.parameters,
            *self.inputs,
            *self.signals,
            *self.outputs,
            *self.indicators,
            *self.output_slopes,
            *self.state_slopes,
        ]

    @property
    def reported(self) -> list[Variable]:
        """The variables whose causality is output."""
        return [*self.outputs, *self.output_slopes]
