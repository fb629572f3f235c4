"""Coefficients of the integration methods, from which templates generate integrators.

Each coefficient of an explicit method is a C expression, stored by the index of its stage.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tableau:
    """An explicit Runge-Kutta method with an error estimate."""

    name: str  # name without the prefix ``cotree_``
    title: str  # description that fits into a sentence
    source: str  # reference for the coefficients
    error_order: int  # order of the embedded error estimate
    memory: str  # exponent of the previous error in step size control
    nodes: tuple[str, ...]  # times of the stages after the first, as fractions of a step
    stages: tuple[dict[int, str], ...]  # weights of earlier stages in each stage after the first
    solution: dict[int, str]  # weights of the stages in the new solution
    #: Weights of the stages in the error estimate; two rows are combined into an estimate of higher
    #: order. The index after the last stage means the rate at the new solution.
    errors: tuple[dict[int, str], ...]
    stable: str  # stability limit on the negative real axis, rounded down
    #: Weights of a term that raises cubic interpolation to degree 4; empty if there is none.
    dense: dict[int, str]

    is_implicit = False

    @property
    def last(self) -> int:
        """Index of the stage at the new solution; it is the first stage of the next step."""
        return len(self.nodes) + 1

    @property
    def probe(self) -> int:
        """Index of the latest stage at the end of a step, apart from the last stage."""
        # The stiffness test (Hairer and Wanner, section IV.2) compares two stages at the end of a
        # step, at nearly the same point. The largest eigenvalue is estimated as the difference of
        # their rates over the difference of their points.
        return max(i for i, node in enumerate(self.nodes, 1) if node == "1.0")

    @property
    def probe_row(self) -> dict[int, str]:
        """Weights of earlier stages in the stage `probe` of the stiffness test."""
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
        # Solution of order 5 minus solution of order 4.
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
        # Solution of order 5 minus solution of order 4.
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
        # The error estimate of order 5 has the weights er of the program DOP853.
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
        # Solution minus embedded solution of order 3, with the weights bhh of DOP853.
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

#: Explicit methods with step size control, by name.
TABLEAUS: dict[str, Tableau] = {row.name: row for row in (_DOPRI5, _RKF45, _DOP853)}


@dataclass(frozen=True)
class RosenbrockTableau:
    """A stiffly accurate Rosenbrock method, in a form without products of the Jacobian and vectors.

    Stages solve (I / (h gamma) - J) u_i = f(t + c_i h, y + sum_j a_ij u_j) + sum_j C_ij u_j / h
    + h d_i f_t. The last stage is the error estimate, and the new solution includes it.
    """

    #: Name, title and reference; see :class:`cotree.codegen.tableaus.Tableau`.
    name: str
    title: str
    source: str
    error_order: int  # order of the embedded error estimate
    gamma: str  # the diagonal coefficient
    #: Coefficients c and d of all stages.
    nodes: tuple[str, ...]
    time: tuple[str, ...]
    #: Coefficients a and C, one row for each stage after the first.
    stages: tuple[tuple[str, ...], ...]
    couplings: tuple[tuple[str, ...], ...]
    #: Weights of the stages in the interpolation polynomial, one row per degree from 2.
    dense: tuple[tuple[str, ...], ...]

    is_implicit = True

    @property
    def n_stages(self) -> int:
        """Number of stages."""
        return len(self.nodes)


# Weights in stage 5. With stage 5, they also form the embedded solution, at which stage 6, the
# error estimate, is evaluated.
_LAST = ("1.221224509226641", "6.019134481288629", "12.53708332932087", "-0.6878860361058950")

# Coefficients for the transformed stages u of Hairer and Wanner, section IV.7.
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

# Weights in stage 6. Stages 7 and 8 are evaluated at the same point plus the preceding stages.
_SIXTH = (
    "-7.502846399306121",
    "2.561846144803919",
    "-11.627539656261098",
    "-0.18268767659942256",
    "0.030198172008377946",
)

_RODAS5 = RosenbrockTableau(
    name="rodas5",
    title="the Rosenbrock method Rodas5P of Steinebach, order 5(4)",
    source="G. Steinebach, Construction of Rosenbrock-Wanner method Rodas5P and numerical "
    "benchmarks within the Julia Differential Equations package, BIT Numerical Mathematics 63, "
    "2023",
    error_order=4,
    gamma="0.21193756319429014",
    nodes=(
        "0.0",
        "0.6358126895828704",
        "0.4095798393397535",
        "0.9769306725060716",
        "0.4288403609558664",
        "1.0",
        "1.0",
        "1.0",
    ),
    time=(
        "0.21193756319429014",
        "-0.42387512638858027",
        "-0.3384627126235924",
        "1.8046452872882734",
        "2.325825639765069",
        "0.0",
        "0.0",
        "0.0",
    ),
    stages=(
        ("3.0",),
        ("2.849394379747939", "0.45842242204463923"),
        ("-6.954028509809101", "2.489845061869568", "-10.358996098473584"),
        ("2.8029986275628964", "0.5072464736228206", "-0.3988312541770524", "-0.04721187230404641"),
        _SIXTH,
        (*_SIXTH, "1.0"),
        (*_SIXTH, "1.0", "1.0"),
    ),
    couplings=(
        ("-14.155112264123755",),
        ("-17.97296035885952", "-2.859693295451294"),
        ("147.12150275711716", "-1.41221402718213", "71.68940251302358"),
        ("165.43517024871676", "-0.4592823456491126", "42.90938336958603", "-5.961986721573306"),
        (
            "24.854864614690072",
            "-3.0009227002832186",
            "47.4931110020768",
            "5.5814197821558125",
            "-0.6610691825249471",
        ),
        (
            "30.91273214028599",
            "-3.1208243349937974",
            "77.79954646070892",
            "34.28646028294783",
            "-19.097331116725623",
            "-28.087943162872662",
        ),
        (
            "37.80277123390563",
            "-3.2571969029072276",
            "112.26918849496327",
            "66.9347231244047",
            "-40.06618937091002",
            "-54.66780262877968",
            "-9.48861652309627",
        ),
    ),
    dense=(
        (
            "25.948786856663858",
            "-2.5579724845846235",
            "10.433815404888879",
            "-2.3679251022685204",
            "0.524948541321073",
            "1.1241088310450404",
            "0.4272876194431874",
            "-0.17202221070155493",
        ),
        (
            "-9.91568850695171",
            "-0.9689944594115154",
            "3.0438037242978453",
            "-24.495224566215796",
            "20.176138334709044",
            "15.98066361424651",
            "-6.789040303419874",
            "-6.710236069923372",
        ),
        (
            "11.419903575922262",
            "2.8879645146136994",
            "72.92137995996029",
            "80.12511834622643",
            "-52.072871366152654",
            "-59.78993625266729",
            "-0.15582684282751913",
            "4.883087185713722",
        ),
    ),
)

#: All Rosenbrock methods, by name.
ROSENBROCK: dict[str, RosenbrockTableau] = {row.name: row for row in (_RODAS4, _RODAS5)}


@dataclass(frozen=True)
class FixedStep:
    """A method with a fixed step size that the caller chooses."""

    name: str  # name without the prefix ``cotree_``
    title: str  # description that fits into a sentence
    source: str  # publication of the coefficients
    order: int  # order of the global error
    n_stages: int  # number of evaluations of the rates per step
    is_implicit: bool  # whether the method solves linear systems


_RK4 = FixedStep(
    name="rk4",
    title="the classical Runge-Kutta method of order 4, with fixed steps",
    source="E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, second "
    "edition, section II.1",
    order=4,
    n_stages=4,
    is_implicit=False,
)

_EULER = FixedStep(
    name="euler",
    title="the linearly implicit Euler method, with fixed steps",
    source="E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, "
    "sections IV.7 and VI.4",
    order=1,
    n_stages=1,
    is_implicit=True,
)

#: All methods with fixed steps, by name.
FIXED: dict[str, FixedStep] = {row.name: row for row in (_RK4, _EULER)}
