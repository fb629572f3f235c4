"""Derivatives that an FMU gives, against those of the kernels of its model."""

from __future__ import annotations

import numpy as np


def expected(model, t, y, p=None, u=None):
    """Rates and outputs by states, inputs and parameters, algebraic unknowns eliminated."""
    layout = model.kernels.layout
    n, m = len(layout.states), len(model.sensitivities)
    n_rates = n - layout.n_algebraic
    jacobian = model.jacobian(t, y, p, u)
    of_p = model.sensitivity_rhs(t, y, np.zeros((n, m)), p, u)
    outputs_of_p = model.output_sensitivity(t, y, np.zeros((n, m)), p, u)
    # The kernel of output sensitivities leaves out states that depend on no parameter, such as
    # modes. By states the graphs of the linearisation are taken, which eliminate unknowns, too.
    outputs_of_x = np.zeros((len(layout.outputs), n))
    f = np.vstack([np.hstack([jacobian, of_p]), np.hstack([outputs_of_x, outputs_of_p])])
    g = f[n_rates:n]
    rows = [*range(n_rates), *range(n, len(f))]
    knowns = [*range(n_rates), *range(n, n + m)]
    wanted, rounding = f[np.ix_(rows, knowns)], 0.0
    if layout.n_algebraic:
        z_v = -np.linalg.solve(g[:, n_rates:n], g[:, knowns])
        # Eliminations agree as far as the condition of g_z lets them, in terms that cancel.
        terms = np.abs(f[np.ix_(rows, range(n_rates, n))]) @ np.abs(z_v)
        rounding = 1e-16 * np.linalg.cond(g[:, n_rates:n]) * np.max(terms)
        wanted += f[np.ix_(rows, range(n_rates, n))] @ z_v
    linear = model.linearize(t, y, p, u)
    # Modes are no states of a linearisation; outputs here are none of theirs.
    moving = [model.states.index(name) for name in linear.states]
    wanted[np.ix_(range(n_rates, len(wanted)), moving)] = linear.C
    if layout.n_algebraic:
        outputs = _outputs_by_unknowns(model, t, y, p, u)
        wanted[n_rates:, n_rates:] += outputs @ z_v[:, n_rates:]
    return wanted, rounding


def _outputs_by_unknowns(model, t, y, p, u):
    n_rates = len(y) - model.kernels.layout.n_algebraic
    m = len(model.sensitivities)
    nothing = model.output_sensitivity(t, y, np.zeros((len(y), m)), p, u)
    columns = []
    for i in range(n_rates, len(y)):
        s = np.zeros((len(y), m))
        s[i] = 1.0
        # The kernel is linear in s.
        columns.append((model.output_sensitivity(t, y, s, p, u) - nothing)[:, 0])
    return np.array(columns).T.reshape(len(nothing), -1)


def close(found, wanted, rounding=0.0):
    # The same operations in another order: rounding of the largest term.
    scale = np.max(np.abs(wanted), initial=1.0)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * scale + rounding)


def compare(unit, model, t, y):
    names = [*unit.rates, *unit.list("output")]
    knowns = [*unit.states, *model.parameters]
    wanted, rounding = expected(model, t, y)
    found = unit.slopes(names, knowns)
    # Modes move at events only: what outputs change by is no derivative that anyone has to know.
    modes = model.linearize(t, y).modes
    of_modes = np.ix_(range(len(unit.rates), len(names)), [name in modes for name in knowns])
    wanted[of_modes] = found[of_modes]
    close(found, wanted, rounding)
    if unit.version == 3:
        close(unit.adjoints(names, knowns), wanted, rounding)
        # Forward and reverse sum the same terms.
        scale = np.max(np.abs(wanted), initial=1.0)
        assert np.max(np.abs(unit.adjoints(names, knowns) - found)) <= 1e-12 * scale + rounding
    return names, knowns
