"""Explicit Runge-Kutta methods, one row each: the data for the template of an integrator.

Coefficients are C expressions, by the number of the stage that they multiply.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tableau:
    """An explicit method with an error estimate.

    Attributes
    ----------
    name : str
        Its name, ``cotree_`` left out.
    title : str
        A description, as a part of a sentence.
    source : str
        Reference of its coefficients.
    error_order : int
        Order of the error estimate.
    memory : str
        Exponent of the error of the step before in the choice of the next step.
    nodes : tuple of str
        Times of the stages but the first, as shares of a step.
    stages : tuple of dict
        Weights of earlier stages in each stage but the first.
    solution : dict
        Weights of the stages in the new solution.
    errors : tuple of dict
        Weights in the error estimate; of two, the second makes up a mean with the first that is
        of higher order. The stage after the last one is the rate at the new solution.
    stable : str
        Stability bound on the negative real axis, a little rounded down.
    dense : dict
        Weights in what the polynomial of degree 4 adds to the cubic through both ends of a step;
        empty where there is none.
    """

    name: str
    title: str
    source: str
    error_order: int
    memory: str
    nodes: tuple[str, ...]
    stages: tuple[dict[int, str], ...]
    solution: dict[int, str]
    errors: tuple[dict[int, str], ...]
    stable: str
    dense: dict[int, str]

    is_implicit = False

    @property
    def last(self) -> int:
        """Number of the stage at the new solution, which begins the next step."""
        return len(self.nodes) + 1

    @property
    def probe(self) -> int:
        """Number of the other stage at the end of a step: the latest before the last one."""
        # Both stages at the end of the step have nearly the same point. The difference of their
        # rates, over that of their points, estimates the largest eigenvalue: a test of stiffness
        # (Hairer and Wanner, section IV.2).
        return max(i for i, node in enumerate(self.nodes, 1) if node == "1.0")

    @property
    def probe_row(self) -> dict[int, str]:
        """Weights of earlier stages in the probe."""
        return self.stages[self.probe - 1]

    @property
    def needs_last(self) -> bool:
        """Whether the error estimate uses the last stage."""
        return any(self.last in row for row in self.errors)


_DOPRI5 = Tableau(
    name="dopri5",
    title="the Runge-Kutta method of Dormand and Prince, order 5(4)",
    source="J. R. Dormand, P. J. Prince, J. Comp. Appl. Math. 6 (1980); E. Hairer, S. P. Norsett, "
    "G. Wanner, Solving Ordinary Differential Equations I, section II.5",
    error_order=4,
    memory="0.04",
    nodes=("1.0 / 5.0", "3.0 / 10.0", "4.0 / 5.0", "8.0 / 9.0", "1.0"),
    stages=(
        {0: "1.0 / 5.0"},
        {0: "3.0 / 40.0", 1: "9.0 / 40.0"},
        {0: "44.0 / 45.0", 1: "-56.0 / 15.0", 2: "32.0 / 9.0"},
        {0: "19372.0 / 6561.0", 1: "-25360.0 / 2187.0", 2: "64448.0 / 6561.0", 3: "-212.0 / 729.0"},
        {
            0: "9017.0 / 3168.0",
            1: "-355.0 / 33.0",
            2: "46732.0 / 5247.0",
            3: "49.0 / 176.0",
            4: "-5103.0 / 18656.0",
        },
    ),
    solution={
        0: "35.0 / 384.0",
        2: "500.0 / 1113.0",
        3: "125.0 / 192.0",
        4: "-2187.0 / 6784.0",
        5: "11.0 / 84.0",
    },
    errors=(
        # The solution of order 5 less that of order 4.
        {
            0: "71.0 / 57600.0",
            2: "-71.0 / 16695.0",
            3: "71.0 / 1920.0",
            4: "-17253.0 / 339200.0",
            5: "22.0 / 525.0",
            6: "-1.0 / 40.0",
        },
    ),
    stable="3.25",
    # L. F. Shampine, Some practical Runge-Kutta formulas, Math. Comp. 46 (1986).
    dense={
        0: "-12715105075.0 / 11282082432.0",
        2: "87487479700.0 / 32700410799.0",
        3: "-10690763975.0 / 1880347072.0",
        4: "701980252875.0 / 199316789632.0",
        5: "-1453857185.0 / 822651844.0",
        6: "69997945.0 / 29380423.0",
    },
)

_RKF45 = Tableau(
    name="rkf45",
    title="the Runge-Kutta method of Fehlberg, order 5(4)",
    source="E. Fehlberg, NASA Technical Report R-315 (1969); the solution of order 5 is kept, as "
    "by L. F. Shampine and H. A. Watts, Sandia report SAND76-0585 (1976)",
    error_order=4,
    memory="0.04",
    nodes=("1.0 / 4.0", "3.0 / 8.0", "12.0 / 13.0", "1.0", "1.0 / 2.0"),
    stages=(
        {0: "1.0 / 4.0"},
        {0: "3.0 / 32.0", 1: "9.0 / 32.0"},
        {0: "1932.0 / 2197.0", 1: "-7200.0 / 2197.0", 2: "7296.0 / 2197.0"},
        {0: "439.0 / 216.0", 1: "-8.0", 2: "3680.0 / 513.0", 3: "-845.0 / 4104.0"},
        {
            0: "-8.0 / 27.0",
            1: "2.0",
            2: "-3544.0 / 2565.0",
            3: "1859.0 / 4104.0",
            4: "-11.0 / 40.0",
        },
    ),
    solution={
        0: "16.0 / 135.0",
        2: "6656.0 / 12825.0",
        3: "28561.0 / 56430.0",
        4: "-9.0 / 50.0",
        5: "2.0 / 55.0",
    },
    errors=(
        # Likewise.
        {
            0: "1.0 / 360.0",
            2: "-128.0 / 4275.0",
            3: "-2197.0 / 75240.0",
            4: "1.0 / 50.0",
            5: "2.0 / 55.0",
        },
    ),
    stable="3.6",
    dense={},
)

_DOP853 = Tableau(
    name="dop853",
    title="the Runge-Kutta method of Dormand and Prince, order 8(5,3)",
    source="E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, second "
    "edition, section II.10",
    error_order=7,
    memory="0.05",
    nodes=(
        "0.05260015195876773",
        "0.0789002279381516",
        "0.1183503419072274",
        "0.2816496580927726",
        "0.3333333333333333",
        "0.25",
        "0.3076923076923077",
        "0.6512820512820513",
        "0.6",
        "0.8571428571428571",
        "1.0",
    ),
    stages=(
        {0: "0.05260015195876773"},
        {0: "0.0197250569845379", 1: "0.0591751709536137"},
        {0: "0.02958758547680685", 2: "0.08876275643042054"},
        {0: "0.2413651341592667", 2: "-0.8845494793282861", 3: "0.924834003261792"},
        {0: "0.037037037037037035", 3: "0.17082860872947386", 4: "0.12546768756682242"},
        {0: "0.037109375", 3: "0.17025221101954405", 4: "0.06021653898045596", 5: "-0.017578125"},
        {
            0: "0.03709200011850479",
            3: "0.17038392571223998",
            4: "0.10726203044637328",
            5: "-0.015319437748624402",
            6: "0.008273789163814023",
        },
        {
            0: "0.6241109587160757",
            3: "-3.3608926294469414",
            4: "-0.868219346841726",
            5: "27.59209969944671",
            6: "20.154067550477894",
            7: "-43.48988418106996",
        },
        {
            0: "0.47766253643826434",
            3: "-2.4881146199716677",
            4: "-0.590290826836843",
            5: "21.230051448181193",
            6: "15.279233632882423",
            7: "-33.28821096898486",
            8: "-0.020331201708508627",
        },
        {
            0: "-0.9371424300859873",
            3: "5.186372428844064",
            4: "1.0914373489967295",
            5: "-8.149787010746927",
            6: "-18.52006565999696",
            7: "22.739487099350505",
            8: "2.4936055526796523",
            9: "-3.0467644718982196",
        },
        {
            0: "2.273310147516538",
            3: "-10.53449546673725",
            4: "-2.0008720582248625",
            5: "-17.9589318631188",
            6: "27.94888452941996",
            7: "-2.8589982771350235",
            8: "-8.87285693353063",
            9: "12.360567175794303",
            10: "0.6433927460157636",
        },
    ),
    solution={
        0: "0.054293734116568765",
        5: "4.450312892752409",
        6: "1.8915178993145003",
        7: "-5.801203960010585",
        8: "0.3111643669578199",
        9: "-0.1521609496625161",
        10: "0.20136540080403034",
        11: "0.04471061572777259",
    },
    errors=(
        # The error of order 5, of which the program DOP853 names the weights er.
        {
            0: "0.01312004499419488",
            5: "-1.2251564463762044",
            6: "-0.4957589496572502",
            7: "1.6643771824549864",
            8: "-0.35032884874997366",
            9: "0.3341791187130175",
            10: "0.08192320648511571",
            11: "-0.022355307863886294",
        },
        # The solution less that of order 3, with the weights bhh of that program.
        {
            0: "-0.18980075407240762",
            5: "4.450312892752409",
            6: "1.8915178993145003",
            7: "-5.801203960010585",
            8: "-0.4226823213237919",
            9: "-0.1521609496625161",
            10: "0.20136540080403034",
            11: "0.02265179219836082",
        },
    ),
    stable="6.1",
    dense={},
)

#: Every explicit method with step control, by name.
TABLEAUS: dict[str, Tableau] = {row.name: row for row in (_DOPRI5, _RKF45, _DOP853)}
