"""The two data structures of an ensemble: what all members share, and the results of some of them.

In: a model, settings of a run and the names of what members differ in. Members themselves are rows
of numbers. Whoever runs a block of rows, on lanes, threads or another machine, gets a ``Plan`` and
these rows, and gives a ``Block``, whose numbers depend on nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray
    from cotree.solvers.settings import Settings

#: Members for which the code of lanes is not compiled, where nobody asks for lanes.
FEW = 100


@dataclass(frozen=True, eq=False)
class Plan:
    """Model and settings that all members of an ensemble share.

    Attributes
    ----------
    model : CompiledModel
        The model.
    settings : Settings
        Settings of each run; ``t_eval`` and ``method`` are given. A member's own values go before
        the parameters and initial values here.
    columns : tuple of str
        Parameters, and states by their initial values, that members set, in the order of a row.
    outputs : tuple of str
        The outputs that are evaluated.
    has_sensitivities : bool
        Whether the sensitivities that the model was compiled with are integrated.
    lanes : int or None
        Members side by side in vectors: 1 for none, None for as many as the processor has.
    is_chosen : bool
        Whether the method was chosen for all members and not asked for, and some may become stiff:
        a member that an explicit one finds stiff on its way is then run from its start with one for
        stiff problems.
    """

    model: CompiledModel
    settings: Settings
    columns: tuple[str, ...]
    outputs: tuple[str, ...] = ()
    has_sensitivities: bool = True
    lanes: int | None = None
    is_chosen: bool = False


@dataclass(frozen=True, eq=False)
class Happened:
    """The events of some members, one entry for each time that one happened.

    Attributes
    ----------
    member : ndarray of int, shape (n,)
        Places of the members in the block, in increasing order.
    event : ndarray of int, shape (n,)
        Numbers of the events in ``model.layout.events``.
    t : ndarray, shape (n,)
        Times, [s], increasing for each member.
    s : ndarray, shape (n, n_parameters)
        Sensitivities of the times, [s / parameter unit].
    """

    member: npt.NDArray[np.intp]
    event: npt.NDArray[np.intp]
    t: FloatArray
    s: FloatArray


@dataclass(frozen=True, eq=False)
class Block:
    """Results of some members, in the order of their rows.

    Attributes
    ----------
    z : ndarray, shape (n_members, n_t, n_states * (1 + n_parameters))
        States, then their sensitivities parameter by parameter. All values of a member that failed
        are nan, and those behind the end of one that an event stopped.
    outputs : ndarray, shape (n_members, n_t, n_outputs)
        Outputs, likewise.
    output_sensitivities : ndarray, shape (n_members, n_t, n_parameters, n_outputs)
        Their sensitivities.
    status : ndarray of int, shape (n_members,)
        As of :class:`cotree.solvers.base.Trajectory`; -3 where the ensemble was stopped before the
        member had run.
    messages : tuple of str
        A sentence for each member that failed or was not run, or that another method ran; empty
        for others.
    steps : ndarray of int, shape (n_members,)
        Accepted steps.
    seconds : ndarray, shape (n_members,)
        Wall-clock time of each, [s]; members in the lanes of one vector share theirs.
    happened : Happened
        The events.
    """

    z: FloatArray
    outputs: FloatArray
    output_sensitivities: FloatArray
    status: npt.NDArray[np.int8]
    messages: tuple[str, ...]
    steps: npt.NDArray[np.int64]
    seconds: FloatArray
    happened: Happened
