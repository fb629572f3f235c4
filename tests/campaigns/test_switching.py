"""Random switching scenes by every method, against an independent solution.

A quick run takes a few scenes, a slow one 60, the campaign 2,000. No run may be off by more than
a hundred tolerances without a message, fail with an exception that is no sentence, or be refused
where its law is continuous; sensitivities are those of differences where the order of switches
stays.
"""

from __future__ import annotations

import os
import tempfile
import warnings
from collections import Counter
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import switching
from switching import T_END, TIMES, Made, Reference

from cotree.errors import Error

if TYPE_CHECKING:
    from cotree import Model

pytestmark = pytest.mark.compiler

ALL = int(os.environ.get("COTREE_CASES", "2000"))
QUICK, SLOW, BLOCK = 3, 60, 20
#: A jump whose condition holds a table: it was met beside a corner of that, and lost its slope. A
#: size that is written by its sign: steps went over its corner, and lost 246 tolerances. Held
#: pieces of a table that Python evaluates, in an FMU, failed on single numbers.
FOUND = (557, 991, 1650)

#: Kinks within roots, exponentials and divisors.
WITHIN = range(switching.FIRST_WITHIN, switching.FIRST_WITHIN + 40)

RTOL, ATOL = 1e-8, 1e-10
#: A hundred tolerances of the largest state, and of methods of variable order a few more for each
#: switch, at which they begin anew by the first order.
MOST_OFF, PER_SWITCH = 100.0, 5.0
#: Of differences with steps of 1e-5 of a reference that is right to about 1e-11.
STEP, NEAR = 1e-5, 1e-4
METHODS = ("dopri5", "rodas5", "cvode", "ida", "dop853", "rkf45", "rodas4", "scipy")

#: What no run may do.
FAULTS = ("crash", "silent error", "refused", "wrong sensitivity", "passed")


def outcomes(seed: int) -> list[str]:
    """Run a scene in two ways or more; return what came of each as ``kind: method: why``."""
    made = switching.make(seed)
    q = made.scene.parameters["q"].number
    reference = switching.solve(made, q)
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of runs that stop: they are counted
        try:
            # The level of a jump on which a run starts, or of an infinite slope, has no derivative,
            # and neither has that of several jumps, which it moves apart.
            has_none = made.n_jumps or "root" in made.law.kinds
            on_jump = made.situation in ("start", "rest") and has_none
            is_common = made.situation != "free" and made.n_jumps > 1
            wanted = ["q"] if on_jump or is_common else ["q", "d"]
            model = made.scene.compile(wanted, optimize="-O0")
        except Error as error:
            return [f"{_of_refusal(made, reference)}: compile: {error}"]
        except Exception as error:
            return [f"crash: compile: {error!r}"]
        method = METHODS[seed % len(METHODS)]
        if method == "scipy":
            method = "dop853" if made.is_continuous else "dopri5"
        found.append(_run(model, made, reference, "auto", q))
        found.append(_run(model, made, reference, method, None))
        if seed % 5 == 0:
            found.append(_ensemble(model, made, reference, q))
        if seed % 100 == 50:
            found.append(_fmu(model, made, reference))
    return found


def _of_refusal(made: Made, reference: Reference) -> str:
    """Classify a run that ends early: a continuous law and a motion of known end may not."""
    if reference.is_open:
        return "open"
    if reference.end < T_END:
        return "stopped where it is driven back"
    return "refused" if made.is_continuous else "refused jump"


def _judged(
    made: Made, reference: Reference, names: dict[str, Any], t: Any, method: str = ""
) -> str:
    """Compare states with the reference, as far as both go."""
    if reference.is_open:
        return "open"
    worst = 0.0
    for name, row in zip(made.names, reference.y, strict=True):
        n = min(len(t), len(row))
        size = np.nanmax(np.abs(row), initial=0.0)
        off = np.abs(np.asarray(names[name])[:n] - row[:n])
        worst = max(worst, float(np.nanmax(off, initial=0.0)) / (ATOL + RTOL * size))
    most = MOST_OFF
    if method in ("cvode", "ida"):
        most += PER_SWITCH * len(reference.order)
    if not worst <= most:
        if _is_sensitive(made):
            return "sensitive"
        return f"silent error of {worst:.0f} tolerances"
    if reference.end < T_END:
        return "passed"
    return "right"


def _is_sensitive(made: Made) -> bool:
    """Whether a change by a tolerance, at the start or later on, becomes more than ten of them."""
    q, h = made.scene.parameters["q"].number, 1e-8
    reference, columns = switching.solve(made, q), []
    for shift in h * np.eye(len(made.start)):
        ends = [switching.solve(made, q, start=list(made.start + way * shift)) for way in (1, -1)]
        if any(own.order != reference.order or own.is_open for own in ends):
            return True
        columns.append((ends[0].y - ends[1].y) / (2.0 * h))
    # What has decayed may grow again: errors that are made in between do so, too. What is left of
    # less than a thousandth is rounding.
    changes = [row for row in np.array(columns).transpose(2, 1, 0) if np.isfinite(row).all()]
    pairs = combinations(changes, 2)
    grown = [np.abs(late @ np.linalg.pinv(early, rcond=1e-3)).max() for early, late in pairs]
    return max(grown, default=0.0) > 10.0


def _run(model: Model, made: Made, reference: Reference, method: str, q: float | None) -> str:
    settings = {"method": method, "rtol": RTOL, "atol": ATOL, "time_limit": 60.0}
    try:
        run = model.simulate((0, T_END), TIMES, sensitivities=q is not None, **settings)
    except Error as error:
        return f"{_of_refusal(made, reference)}: {method}: {error}"
    except Exception as error:
        return f"crash: {method}: {error!r}"
    if run.status < 0:
        return f"{_of_refusal(made, reference)}: {method}: {run.message}"
    kind = _judged(made, reference, run, run.t, method)
    if kind == "right" and q is not None:
        wrong = _wrong_sensitivity(run, made, reference, q)
        if wrong:
            return f"wrong sensitivity: {method}: {wrong}"
    return f"{kind}: {method}"


def _wrong_sensitivity(run: Any, made: Made, reference: Reference, q: float) -> str:
    for name in run.model.sensitivities:
        steps = ((STEP, 0.0), (-STEP, 0.0)) if name == "q" else ((0.0, STEP), (0.0, -STEP))
        up, down = (switching.solve(made, q + a, b) for a, b in steps)
        if not up.order == down.order == reference.order or up.is_open or down.is_open:
            continue
        expected = (up.y - down.y) / (2.0 * STEP)
        bend = np.abs(up.y + down.y - 2.0 * reference.y).max() / STEP
        if bend > NEAR * max(1.0, np.abs(expected).max()):
            continue  # it rests on a kink, and has a derivative from either side
        for i, state in enumerate(made.names):
            found = run.sensitivity(state, name)
            off = np.abs(found - expected[i]).max()
            if not off <= NEAR * max(1.0, np.abs(expected[i]).max()):
                # A kink within the step tilts differences, a jump at a time that is wanted, too.
                near = (_slope(made, q, name, STEP / 20.0)[i], _slope(made, q, name, STEP * 4.0)[i])
                if np.abs(near[0] - near[1]).max() > 0.1 * off:
                    continue
                return f"of {state} to {name} off by {off:.1e} at {np.abs(expected[i]).max():.1e}"
    return ""


def _slope(made: Made, q: float, name: str, step: float) -> np.ndarray:
    shifts = ((step, 0.0), (-step, 0.0)) if name == "q" else ((0.0, step), (0.0, -step))
    up, down = (switching.solve(made, q + a, b) for a, b in shifts)
    return np.asarray((up.y - down.y) / (2.0 * step))


def _ensemble(model: Model, made: Made, reference: Reference, q: float) -> str:
    try:
        runs = model.ensemble(
            (0, T_END),
            {"q": [0.95 * q, q, 1.05 * q]},
            t_eval=TIMES,
            rtol=RTOL,
            atol=ATOL,
            threads=1,
        )
    except Error as error:
        return f"{_of_refusal(made, reference)}: ensemble: {error}"
    except Exception as error:
        return f"crash: ensemble: {error!r}"
    if int(runs["status"].values[1]) < 0:
        return f"{_of_refusal(made, reference)}: ensemble: {runs['message'].values[1]}"
    values = {name: runs[name].values[1] for name in made.names}
    return f"{_judged(made, reference, values, TIMES)}: ensemble"


def _fmu(model: Model, made: Made, reference: Reference) -> str:
    fmpy = pytest.importorskip("fmpy")
    with tempfile.TemporaryDirectory() as folder:
        try:
            unit = model.export_fmu(Path(folder) / "unit.fmu", version=3)
        except Error as error:
            return f"{_of_refusal(made, reference)}: FMU: {error}"
        try:
            rows = fmpy.simulate_fmu(
                str(unit.path),
                fmi_type="CoSimulation",
                stop_time=T_END,
                output_interval=TIMES[1],
                step_size=TIMES[1],
                relative_tolerance=RTOL,
                output=made.names,
                record_events=False,
            )
        except Exception as error:
            return f"{_of_refusal(made, reference)}: FMU: {error!r}"
    return f"{_judged(made, reference, {n: rows[n] for n in made.names}, TIMES)}: FMU"


def check(seeds: range) -> Counter[str]:
    """Run some scenes; nothing that no run may do is among what came of them."""
    found = {seed: outcomes(seed) for seed in seeds}
    bad = {
        seed: [row for row in rows if row.startswith(FAULTS)]
        for seed, rows in found.items()
        if any(row.startswith(FAULTS) for row in rows)
    }
    assert not bad, bad
    return Counter(row.partition(":")[0] for rows in found.values() for row in rows)


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(i, marks=[pytest.mark.slow] if QUICK <= i < SLOW or i in WITHIN[2:] else [])
        for i in (*range(SLOW), *FOUND, *WITHIN)
    ],
)
def test_a_switching_scene_is_right_or_says_why_not(seed: int) -> None:
    check(range(seed, seed + 1))


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("first", range(0, ALL, BLOCK))
def test_all_switching_scenes_are_right_or_say_why_not(first: int) -> None:
    counts = check(range(first, first + BLOCK))
    assert counts["right"] > BLOCK // 2, counts
