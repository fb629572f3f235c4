"""Parcels for workers, and their work there: a plan, sent once, and rows of members.

In: a plan as bytes with their hash. Out: the block of some rows. A worker keeps the last plans by
their hashes, since most blocks come with the hash alone; one that does not know it asks for it.
"""

from __future__ import annotations

import hashlib
import pickle
import socket
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.ensemble.batch import run_block
from cotree.errors import BuildError, SolveError

if TYPE_CHECKING:
    from cotree.ensemble.plan import Block, Plan
    from cotree.solvers.base import FloatArray

# A worker that serves several ensembles in turn keeps their models; libraries stay loaded anyway.
_MOST_KEPT = 8

_kept: OrderedDict[str, Plan] = OrderedDict()
_keeping = threading.RLock()


@dataclass(frozen=True)
class Parcel:
    """A plan on its way.

    Attributes
    ----------
    key : str
        Hash of the bytes.
    backend : str
        The evaluator of the sender's kernels; another one gives other last digits.
    data : bytes or None
        The pickled plan; None where the worker presumably has it.
    """

    key: str
    backend: str
    data: bytes | None


def parcel_of(plan: Plan) -> Parcel:
    """Pickle a plan.

    Raises
    ------
    SolveError
        If it holds what cannot be sent.
    """
    try:
        data = pickle.dumps(plan, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise SolveError(
            f"the ensemble cannot be sent to other processes ({error}): give inputs as tables or "
            "expressions, or as functions of a module that workers can import"
        ) from error
    return Parcel(hashlib.sha256(data).hexdigest(), plan.model.backend, data)


def run_parcel(
    parcel: Parcel, rows: FloatArray, threads: int, attempt: int
) -> tuple[Block, float] | None:
    """Run members in a worker.

    Parameters
    ----------
    parcel : Parcel
        The plan.
    rows : ndarray, shape (n_members, n_columns)
        The members.
    threads : int
        Threads to run them in.
    attempt : int
        How often they were submitted before. Executors that know a call by its arguments, as
        dask does, would else give the answer of the first.

    Returns
    -------
    (Block, float) or None
        The results, and how long they took, [s]. None where the plan is not known here.

    Raises
    ------
    BuildError
        If the model cannot be compiled here as where it comes from.
    """
    plan = _plan_of(parcel)
    return None if plan is None else run_here(plan, rows, threads)


def run_here(
    plan: Plan, rows: FloatArray, threads: int, stop: threading.Event | None = None
) -> tuple[Block, float]:
    """Run members in this process; see :func:`run_parcel`. They are broken off by an event."""
    begun = time.perf_counter()
    block = run_block(plan, rows, threads=threads, stop=stop)
    return block, time.perf_counter() - begun


def _plan_of(parcel: Parcel) -> Plan | None:
    """Give the plan of a parcel, unpickled by one thread while others wait."""
    with _keeping:
        plan = _kept.get(parcel.key)
        if plan is None:
            if parcel.data is None:
                return None
            plan = pickle.loads(parcel.data)
            _check_backend(plan.model, parcel.backend)
            _kept[parcel.key] = plan
            if len(_kept) > _MOST_KEPT:
                _kept.popitem(last=False)
        _kept.move_to_end(parcel.key)
        return plan


def _check_backend(model: Any, backend: str) -> None:
    if model.backend != backend:
        raise BuildError(
            f"the worker on '{socket.gethostname()}' evaluates the model in {model.backend}, and "
            f"where the ensemble was started it is {backend}: results would differ in their last "
            "digits. Install a C compiler on all machines (or: pip install ziglang), or set "
            "COTREE_COMPILER=none on all"
        )
