"""Rosenbrock methods, one row each: what the template of an integrator is told of it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RosenbrockTableau:
    """A stiffly accurate Rosenbrock method, written without products of the Jacobian.

    Stages solve (I / (h gamma) - J) u_i = f(t + c_i h, y + sum_j a_ij u_j) + sum_j C_ij u_j / h
    + h d_i f_t. The last one is the error of the sum before it, the new solution that sum with it.

    Attributes
    ----------
    name, title, source : str
        As in :class:`cotree.codegen.tableaus.Tableau`.
    error_order : int
        Order of the error estimate.
    gamma : str
        The diagonal.
    nodes, time : tuple of str
        c and d, one of each stage.
    stages, couplings : tuple of tuple of str
        a and C, a row for each stage but the first.
    dense : tuple of tuple of str
        Weights of the stages in the polynomial of degree 3 through both ends of a step.
    """

    name: str
    title: str
    source: str
    error_order: int
    gamma: str
    nodes: tuple[str, ...]
    time: tuple[str, ...]
    stages: tuple[tuple[str, ...], ...]
    couplings: tuple[tuple[str, ...], ...]
    dense: tuple[tuple[str, ...], ...]

    is_implicit = True

    @property
    def n_stages(self) -> int:
        """Number of stages."""
        return len(self.nodes)


_LAST = ("1.221224509226641", "6.019134481288629", "12.53708332932087", "-0.6878860361058950")

_RODAS4 = RosenbrockTableau(
    name="rodas4",
    title="the Rosenbrock method of Hairer and Wanner, order 4(3)",
    source="E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, "
    "section IV.7 and its program RODAS",
    error_order=3,
    gamma="0.25",
    nodes=("0.0", "0.386", "0.21", "0.63", "1.0", "1.0"),
    time=("0.25", "-0.1043", "0.1035", "-0.0362", "0.0", "0.0"),
    stages=(
        ("1.544",),
        ("0.9466785280815826", "0.2557011698983284"),
        ("3.314825187068521", "2.896124015972201", "0.9986419139977817"),
        _LAST,
        (*_LAST, "1.0"),
    ),
    couplings=(
        ("-5.6688",),
        ("-2.430093356833875", "-0.2063599157091915"),
        ("-0.1073529058151375", "-9.594562251023355", "-20.47028614809616"),
        ("7.496443313967647", "-10.24680431464352", "-33.99990352819905", "11.70890893206160"),
        (
            "8.083246795921522",
            "-7.981132988064893",
            "-31.52159432874371",
            "16.31930543123136",
            "-6.058818238834054",
        ),
    ),
    dense=(
        (
            "10.12623508344586",
            "-7.487995877610167",
            "-34.80091861555747",
            "-7.992771707568823",
            "1.025137723295662",
        ),
        (
            "-0.6762803392801253",
            "6.087714651680015",
            "16.43084320892478",
            "24.76722511418386",
            "-6.594389125716872",
        ),
    ),
)

#: Every Rosenbrock method, by name.
ROSENBROCK: dict[str, RosenbrockTableau] = {row.name: row for row in (_RODAS4,)}
