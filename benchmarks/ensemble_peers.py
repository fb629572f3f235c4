"""Members of an ensemble by other tools, with the same equations, states and order of results.

heyoka takes Taylor steps of several members in the lanes of vectors. Diffrax takes steps of all
members in one array; sensitivities are additional states, whose rates are Jacobian-vector products.
"""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
from peer_equations import Equations

#: Absolute tolerances by relative ones, where tools have both: the quickest of 1e-2, 1e-1 and 1.
ATOL = 0.1


class Heyoka:
    """Taylor's method in batches of the recommended width, with variational equations.

    Parameters
    ----------
    model : cotree.Model
        Model, compiled with the sensitivities to integrate.
    columns : sequence of str
        Parameters whose values differ between members.
    start : ndarray, shape (n_states * (1 + n_sensitivities),)
        States at the start and their sensitivities parameter by parameter, the same for all
        members.
    """

    name, is_quick = "heyoka", True

    def __init__(self, model: Any, columns: list[str], start: Any) -> None:
        import heyoka as hy

        self.hy, self.n = hy, len(model.states)
        self.k = len(model.sensitivities)
        self.width = hy.recommended_simd_size()
        names = [*columns, *(name for name in model.sensitivities if name not in columns)]
        states = [hy.make_vars(f"x{i}") for i in range(self.n)]
        parameters = [hy.par[i] for i in range(len(names))]
        made = Equations(model, hy, states, parameters, hy.time, names)
        self.values = np.array(made.values)
        rates = [hy.expression(r) if isinstance(r, float) else r for r in made.rates]
        self.system = list(zip(states, rates, strict=True))
        if self.k:
            own = [parameters[names.index(name)] for name in model.sensitivities]
            self.system = hy.var_ode_sys(self.system, own, order=1)
        # heyoka's variations stand state by state, those of one by all parameters together.
        own_order = start[self.n :].reshape(self.k, self.n).T.ravel()
        self.start = np.concatenate([start[: self.n], own_order])
        # Else it would compile for minutes.
        self.is_large = len(model.kernels.program.kernels["rhs"].order) > 200 or len(start) > 50
        self.made: dict[float, Any] = {}

    def run(self, rows: Any, times: Any, tolerance: float) -> tuple[Any, float]:
        """Run members.

        Returns
        -------
        ndarray, shape (n_members, n_t, n_states * (1 + n_sensitivities))
            States, then their sensitivities parameter by parameter.
        float
            Processor time of the tool itself, [s].
        """
        width = self.width
        if tolerance not in self.made:
            begin = self.start[: self.n] if self.k else self.start
            self.made[tolerance] = self.hy.taylor_adaptive_batch(
                self.system, np.tile(begin[:, None], width), tol=tolerance,
                pars=np.tile(self.values[:, None], width), compact_mode=self.is_large,
            )  # fmt: skip
        integrator = self.made[tolerance]
        grid = np.tile(times[:, None], width)
        found, seconds = np.empty((len(rows), len(times), len(self.start))), 0.0
        for first in range(0, len(rows), width):
            # The last batch is filled up with its last member.
            some = np.minimum(np.arange(first, first + width), len(rows) - 1)
            integrator.set_time(float(times[0]))
            integrator.state[:] = self.start[:, None]
            integrator.pars[: rows.shape[1]] = rows[some].T
            begin = time.process_time()
            values = integrator.propagate_grid(grid)
            seconds += time.process_time() - begin
            values = values[-1] if isinstance(values, tuple) else values
            found[some] = values.transpose(2, 0, 1)
        if self.k:
            shape = (*found.shape[:2], self.n, self.k)
            found[..., self.n :] = (
                found[..., self.n :].reshape(shape).swapaxes(2, 3).reshape(*found.shape[:2], -1)
            )
        return found, seconds


class Diffrax:
    """Dopri8 of Diffrax for all members in one array on one thread, compiled by XLA."""

    name, is_quick = "Diffrax", False

    def __init__(self, model: Any, columns: list[str], start: Any) -> None:
        # Read when JAX is imported.
        os.environ.setdefault(
            "XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
        )
        import diffrax
        import jax

        jax.config.update("jax_enable_x64", True)
        self.jax, self.diffrax, self.model = jax, diffrax, model
        self.n, self.k = len(model.states), len(model.sensitivities)
        self.names = [*columns, *(name for name in model.sensitivities if name not in columns)]
        layout = model.kernels.program.layout
        values = dict(zip(model.parameters, layout.parameter_values, strict=True))
        self.rest = np.array([float(values[name]) for name in self.names[len(columns) :]])
        places = [self.names.index(name) for name in model.sensitivities]
        self.directions = np.eye(len(self.names))[places]
        self.start = start
        self.made: Any = None

    def _rates(self, t: Any, z: Any, p: Any) -> Any:
        jnp, n = self.jax.numpy, self.n

        def rates(x: Any, q: Any) -> Any:
            made = Equations(self.model, jnp, list(x), list(q), t, self.names)
            return jnp.stack([jnp.asarray(rate, dtype=float) for rate in made.rates])

        if not self.k:
            return rates(z, p)
        along = self.jax.vmap(lambda s, d: self.jax.jvp(rates, (z[:n], p), (s, d))[1])
        changes = along(z[n:].reshape(self.k, n), self.directions)
        return jnp.concatenate([rates(z[:n], p), changes.ravel()])

    def run(self, rows: Any, times: Any, tolerance: float) -> tuple[Any, float]:
        """Run members.

        Returns
        -------
        ndarray, shape (n_members, n_t, n_states * (1 + n_sensitivities))
            States, then their sensitivities parameter by parameter.
        float
            Processor time of the tool itself, [s].
        """
        every = np.hstack([rows, np.tile(self.rest, (len(rows), 1))])
        if self.made is None:
            self.made = self.jax.jit(self.jax.vmap(self._solve(times), (0, None)))
        self.made(every, tolerance).block_until_ready()  # compiles where it has to
        begin = time.process_time()
        found = np.asarray(self.made(every, tolerance))
        return found, time.process_time() - begin

    def _solve(self, times: Any) -> Any:
        dfx = self.diffrax

        def solve(p: Any, tolerance: Any) -> Any:
            return dfx.diffeqsolve(
                dfx.ODETerm(self._rates), dfx.Dopri8(), times[0], times[-1], None,
                self.jax.numpy.asarray(self.start), args=p, saveat=dfx.SaveAt(ts=times),
                stepsize_controller=dfx.PIDController(rtol=tolerance, atol=tolerance * ATOL),
                max_steps=100_000, adjoint=dfx.ForwardMode(),
            ).ys  # fmt: skip

        return solve


PEERS = (Heyoka, Diffrax)
