"""Pinocchio's states and accelerations in the names of a scene that read_urdf gives.

Pinocchio orders a free body's pose as position and quaternion (x, y, z, w), its velocity as linear,
then angular, both in the body's axes; cotree has the quaternion scalar first, and the velocity of
the node in the axes of the node that it moves against. Unbounded angles are (cos, sin) there.
"""

from __future__ import annotations

import numpy as np
import pinocchio


def rotation(q):
    """The matrix of a unit quaternion, scalar first."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


class Peer:
    """A robot in Pinocchio, spoken to by names of the scene's states."""

    def __init__(self, path, scene, base="fixed", mimic=False):
        if base == "free":
            root = pinocchio.JointModelFreeFlyer()
            self.model = pinocchio.buildModelFromUrdf(str(path), root, mimic)
        else:
            self.model = pinocchio.buildModelFromUrdf(str(path), mimic)
        self.data = self.model.createData()
        called = {
            name: given for (kind, name), given in scene.origin.names.items() if kind == "joint"
        }
        base_edge = next(iter(scene.edges))
        self.called = {
            given: name for (kind, name), given in scene.origin.names.items() if kind == "link"
        }
        self.rows = []  # edge, kind, where in q, where in v
        for i in range(1, self.model.njoints):
            name, joint = self.model.names[i], self.model.joints[i]
            edge = base_edge if name == "root_joint" else called.get(name, name)
            kind = scene.edges[edge].component.name
            if joint.nv:
                self.rows.append((edge, kind, joint.idx_q, joint.idx_v, joint.nq))

    def random(self, rng):
        """Return a random state, and torques of the joints with an input, by name."""
        state, inputs = {}, {}
        for edge, kind, *_ in self.rows:
            if kind == "revolute":
                state[f"{edge}.theta"] = rng.uniform(-np.pi, np.pi)
                state[f"{edge}.theta_dot"] = rng.normal()
                inputs[f"{edge}_torque"] = 10.0 * rng.normal()
            elif kind == "prismatic":
                state[f"{edge}.s"] = rng.uniform(-1.0, 1.0)
                state[f"{edge}.s_dot"] = rng.normal()
                inputs[f"{edge}_force"] = 10.0 * rng.normal()
            elif kind == "planar":
                for name in ("x", "y", "theta", "x_dot", "y_dot", "theta_dot"):
                    state[f"{edge}.{name}"] = rng.normal()
            else:
                q = rng.normal(size=4)
                q /= np.linalg.norm(q)
                state |= {f"{edge}.q{i}": q[i] for i in range(4)}
                for name in ("x", "y", "z", "vx", "vy", "vz", "w1", "w2", "w3"):
                    state[f"{edge}.{name}"] = rng.normal()
        return state, inputs

    def pose(self, state):
        """Return Pinocchio's q."""
        q = np.zeros(self.model.nq)
        for edge, kind, at, _, nq in self.rows:
            if kind == "prismatic":
                q[at] = state[f"{edge}.s"]
            elif kind == "revolute":
                angle = state[f"{edge}.theta"]
                q[at : at + nq] = angle if nq == 1 else (np.cos(angle), np.sin(angle))
            elif kind == "planar":
                angle = state[f"{edge}.theta"]
                place = (state[f"{edge}.x"], state[f"{edge}.y"])
                q[at : at + 4] = (*place, np.cos(angle), np.sin(angle))
            else:
                place = [state[f"{edge}.{name}"] for name in "xyz"]
                w, *xyz = (state[f"{edge}.q{i}"] for i in range(4))
                q[at : at + 7] = (*place, *xyz, w)
        return q

    def velocity(self, state):
        """Return Pinocchio's v."""
        v = np.zeros(self.model.nv)
        for edge, kind, _, at, _ in self.rows:
            if kind in ("revolute", "prismatic"):
                v[at] = state[f"{edge}.{'s' if kind == 'prismatic' else 'theta'}_dot"]
            elif kind == "planar":
                turn = _plane(state[f"{edge}.theta"])
                v[at : at + 2] = turn.T @ [state[f"{edge}.x_dot"], state[f"{edge}.y_dot"]]
                v[at + 2] = state[f"{edge}.theta_dot"]
            else:
                turn = rotation([state[f"{edge}.q{i}"] for i in range(4)])
                v[at : at + 3] = turn.T @ [state[f"{edge}.v{name}"] for name in "xyz"]
                v[at + 3 : at + 6] = [state[f"{edge}.w{i}"] for i in (1, 2, 3)]
        return v

    def efforts(self, inputs):
        """Return Pinocchio's tau."""
        tau = np.zeros(self.model.nv)
        for edge, kind, _, at, _ in self.rows:
            if kind in ("revolute", "prismatic"):
                tau[at] = inputs[f"{edge}_{'force' if kind == 'prismatic' else 'torque'}"]
        return tau

    def accelerations(self, state, a):
        """Return rates of the scene's speeds, by name, from Pinocchio's a."""
        rates = {}
        for edge, kind, _, at, _ in self.rows:
            if kind in ("revolute", "prismatic"):
                rates[f"{edge}.{'s' if kind == 'prismatic' else 'theta'}_dot"] = a[at]
            elif kind == "planar":
                turn = _plane(state[f"{edge}.theta"])
                w = state[f"{edge}.theta_dot"]
                place = np.array([state[f"{edge}.x_dot"], state[f"{edge}.y_dot"]])
                local = turn.T @ place
                linear = turn @ (a[at : at + 2] + w * np.array([-local[1], local[0]]))
                rates |= {f"{edge}.x_dot": linear[0], f"{edge}.y_dot": linear[1]}
                rates[f"{edge}.theta_dot"] = a[at + 2]
            else:
                turn = rotation([state[f"{edge}.q{i}"] for i in range(4)])
                w = np.array([state[f"{edge}.w{i}"] for i in (1, 2, 3)])
                v = np.array([state[f"{edge}.v{name}"] for name in "xyz"])
                linear = turn @ (a[at : at + 3] + np.cross(w, turn.T @ v))
                rates |= {f"{edge}.v{name}": linear[i] for i, name in enumerate("xyz")}
                rates |= {f"{edge}.w{i + 1}": a[at + 3 + i] for i in range(3)}
        return rates

    def solved(self, state, inputs):
        """Return its a: by articulated bodies, or by the mass matrix if joints mimic others."""
        q, v, tau = self.pose(state), self.velocity(state), self.efforts(inputs)
        if not self.model.mimicking_joints:
            return pinocchio.aba(self.model, self.data, q, v, tau)
        # Pinocchio 4.1 leaves entries of an earlier mass matrix there when joints mimic.
        data = self.model.createData()
        upper = np.triu(pinocchio.crba(self.model, data, q))
        mass = upper + np.triu(upper, 1).T
        bias = pinocchio.nonLinearEffects(self.model, data, q, v)
        return np.linalg.solve(mass, tau - bias)

    def forward(self, state, inputs):
        """Return rates of the scene's speeds."""
        return self.accelerations(state, self.solved(state, inputs))

    def derivatives(self, state, inputs):
        """Return da/dq and da/dv in Pinocchio's own tangents, shapes (nv, nv)."""
        q, v, tau = self.pose(state), self.velocity(state), self.efforts(inputs)
        pinocchio.computeABADerivatives(self.model, self.data, q, v, tau)
        return self.data.ddq_dq.copy(), self.data.ddq_dv.copy()

    def in_own_tangents(self, state, model, jacobian, rates):
        """Turn a scene's Jacobian into Pinocchio's da/dq and da/dv.

        A free body's pose moves along its own axes there, and its velocity v and acceleration a are
        those of R^T v and its rate: with R turned by d, R^T turns by -d, while v itself goes along.

        Parameters
        ----------
        state : mapping of str to float
            By the scene's names.
        model : Model
            Of the scene, for the order of its states.
        jacobian : ndarray, shape (n_states, n_states)
            Of the scene.
        rates : mapping of str to float
            Rates of the scene's speeds there.
        """
        n = self.model.nv
        at = {name: i for i, name in enumerate(model.states)}
        poses, speeds = np.zeros((len(at), n)), np.zeros((len(at), n))
        back = np.zeros((n, len(at)))
        poses_extra, speeds_extra = np.zeros((n, n)), np.zeros((n, n))
        for edge, kind, _, i, _ in self.rows:
            if kind in ("revolute", "prismatic"):
                name = f"{edge}.{'s' if kind == 'prismatic' else 'theta'}"
                poses[at[name], i] = speeds[at[f"{name}_dot"], i] = 1.0
                back[i, at[f"{name}_dot"]] = 1.0
                continue
            assert kind == "free"
            q = [state[f"{edge}.q{k}"] for k in range(4)]
            turn = rotation(q)
            places, turns = (
                [at[f"{edge}.{k}"] for k in "xyz"],
                [at[f"{edge}.q{k}"] for k in range(4)],
            )
            v_at, w_at = (
                [at[f"{edge}.v{k}"] for k in "xyz"],
                [at[f"{edge}.w{k}"] for k in (1, 2, 3)],
            )
            v, linear = (
                turn.T @ [table[f"{edge}.v{k}"] for k in "xyz"] for table in (state, rates)
            )
            w = np.array([state[f"{edge}.w{k}"] for k in (1, 2, 3)])
            a, b, c, d = q
            poses[np.ix_(places, range(i, i + 3))] = turn
            poses[np.ix_(turns, range(i + 3, i + 6))] = 0.5 * np.array(
                [[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]]
            )
            poses[np.ix_(v_at, range(i + 3, i + 6))] = -turn @ _skew(v)
            speeds[np.ix_(v_at, range(i, i + 3))] = turn
            speeds[np.ix_(w_at, range(i + 3, i + 6))] = np.eye(3)
            back[np.ix_(range(i, i + 3), v_at)] = turn.T
            back[np.ix_(range(i + 3, i + 6), w_at)] = np.eye(3)
            # a = R^T v' - w x (R^T v)
            poses_extra[i : i + 3, i + 3 : i + 6] = _skew(linear)
            speeds_extra[i : i + 3, i : i + 3] = -_skew(w)
            speeds_extra[i : i + 3, i + 3 : i + 6] = _skew(v)
        return back @ jacobian @ poses + poses_extra, back @ jacobian @ speeds + speeds_extra

    def to_inertia(self, state, inputs, link, columns):
        """Return the derivatives of the rates of speeds by what an inertia's entries depend on.

        Parameters
        ----------
        link : str
            The link, as the scene calls it.
        columns : sequence of ndarray, shape (10,)
            Each a derivative of the link's mass, first and second moments in the link's axes, as
            ``Inertia.toDynamicParameters`` orders them.

        Returns
        -------
        list of dict of str to float
            For each column.
        """
        q, v, a = self.pose(state), self.velocity(state), self.solved(state, inputs)
        frame = self.model.frames[self.model.getFrameId(self.called.get(link, link))]
        if frame.parentJoint == 0:
            return [dict.fromkeys(self.accelerations(state, a), 0.0) for _ in columns]
        pinocchio.computeJointTorqueRegressor(self.model, self.data, q, v, a)
        regressor = self.data.jointTorqueRegressor[:, 10 * (frame.parentJoint - 1) :][:, :10]
        upper = np.triu(pinocchio.crba(self.model, self.data, q))
        mass = upper + np.triu(upper, 1).T
        still = self.accelerations(state, np.zeros(self.model.nv))
        found = []
        for column in columns:
            slope = -np.linalg.solve(mass, regressor @ _moved(frame.placement, column))
            rates = self.accelerations(state, slope)
            found.append({name: rates[name] - still[name] for name in rates})
        return found


def inertial_columns(turn, mass, centre, moments):
    """Return the derivatives of an inertia's ten entries by what a URDF file says of it.

    Each is quadratic in each number at most, so that central differences are exact but for
    rounding.

    Parameters
    ----------
    turn : ndarray, shape (3, 3)
        Axes of the moments in the link's.
    mass, centre, moments : float and sequences of three and of six float
        As the file has them.
    """
    base = np.array([mass, *centre, *moments])
    found = []
    for i in range(10):
        step = np.zeros(10)
        step[i] = 0.5
        found.append(_entries(turn, base + step) - _entries(turn, base - step))
    return found


def _entries(turn, numbers):
    """Mass, first moments, and second moments about the link's origin, in Pinocchio's order."""
    mass, centre = numbers[0], numbers[1:4]
    xx, xy, xz, yy, yz, zz = numbers[4:]
    tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    tensor = tensor + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array(
        [mass, *(mass * centre), tensor[0, 0], tensor[0, 1], tensor[1, 1], *tensor[:, 2]]
    )


def _moved(placement, column):
    """Carry the derivative of an inertia from a link's axes to its joint's; it is linear."""
    turn, arm = placement.rotation, placement.translation
    mass, first = column[0], turn @ column[1:4]
    xx, xy, yy, xz, yz, zz = column[4:]
    tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
    both = 2.0 * arm @ first * np.eye(3) - np.outer(arm, first) - np.outer(first, arm)
    tensor = tensor + both + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return np.array(
        [mass, *(first + mass * arm), tensor[0, 0], tensor[0, 1], tensor[1, 1], *tensor[:, 2]]
    )


def _skew(a):
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _plane(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
