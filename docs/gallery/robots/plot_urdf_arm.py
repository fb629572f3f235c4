"""
Robot arm from a URDF file
==========================

cotree translates a URDF file into a scene, whose nodes are the links and whose edges are the joints
with drives. All masses and moments of inertia are parameters. The arm falls from a horizontal
position and swings.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import cotree

LINK = """
<link name="{name}">
  <inertial>
    <origin xyz="{half} 0 0"/> <mass value="{mass}"/>
    <inertia ixx="0.001" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>
  </inertial>
  <visual><origin xyz="{half} 0 0"/> <geometry><box size="{length} 0.05 0.05"/></geometry></visual>
</link>"""
JOINT = """
<joint name="{name}" type="revolute">
  <parent link="{parent}"/> <child link="{child}"/> <origin xyz="{x} 0 0"/> <axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="50" velocity="5"/> <dynamics damping="0.4"/>
</joint>"""
upper = {"name": "upper", "length": 0.5, "half": 0.25, "mass": 2.0, "inertia": 0.05}
fore = {"name": "fore", "length": 0.4, "half": 0.2, "mass": 1.0, "inertia": 0.02}
urdf = f"""<robot name="arm"><link name="base"/>{LINK.format(**upper)}{LINK.format(**fore)}
{JOINT.format(name="shoulder", parent="base", child="upper", x=0)}
{JOINT.format(name="elbow", parent="upper", child="fore", x=0.5)}</robot>"""

with TemporaryDirectory() as folder:
    path = Path(folder, "arm.urdf")
    path.write_text(urdf, encoding="utf-8")
    scene = cotree.read_urdf(path)
print(scene.summary())

# %%
# The initial acceleration of the shoulder has a closed form. It is the solution of two equations
# with the mass matrix of a two-link arm (J. Craig, *Introduction to Robotics*, section 6.7). The
# arm is at rest and stretched. The two-by-two system is well conditioned.
model = scene.compile()
rates = model.rhs(0.0, model.initial_state)
m1, m2, l1, c1, c2, i1, i2, g = 2.0, 1.0, 0.5, 0.25, 0.2, 0.05, 0.02, 9.81
m22 = i2 + m2 * c2**2
m12 = m22 + m2 * l1 * c2
m11 = i1 + m1 * c1**2 + i2 + m2 * (l1 + c2) ** 2
weight = [g * (m1 * c1 + m2 * (l1 + c2)), g * m2 * c2]
exact = np.linalg.solve([[m11, m12], [m12, m22]], weight)
found = rates[model.states.index("shoulder.theta_dot")]
print(f"acceleration of the shoulder {found:.9f} rad/s^2, closed form {exact[0]:.9f} rad/s^2")
assert abs(found - exact[0]) < 1e-11

# %%
# The animation shows the motion with dampers in both joints:
result = model.simulate((0, 6), np.linspace(0, 6, 601))
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), width_ratios=[1.4, 1])
for joint in ("shoulder", "elbow"):
    left.plot(result.t, np.degrees(result[f"{joint}.theta"]), label=joint)
left.set(xlabel="time [s]", ylabel="angle of the joint [deg]")
left.legend()
right.imshow(result.animate(speed=1.0).frame(10, width=500, height=500))
right.axis("off")
plt.show()

# %%
# The shapes come from the URDF file.
result.animate(speed=1.0)
