"""
Control blocks: PID, sampling, delay and gain scheduling
========================================================

Signal blocks come with cotree as parts. This page shows a PID controller with limits, a sampled
controller, transfer functions and delays, and a gain that is scheduled by a lookup table. If a
closed form exists, the result is compared with it.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree


def motor(controller: str, **bindings: float | str) -> cotree.Scene:
    """Build a scene in which a controller drives the speed of a flywheel to one."""
    scene = cotree.Scene("drive")
    scene.edge("wheel", "rotational_inertia", "ground", "shaft", inertia=1.0)
    scene.edge("bearing", "rotational_damper", "ground", "shaft", damping=0.2)
    scene.add("pid", controller, u="1 - wheel.w", **bindings)
    scene.edge("drive", "torque_source", "ground", "shaft", torque="pid.y")
    return scene


# %%
# The torque is limited to 0.4 and saturates at first. A very long time constant ``Tt`` turns off
# the anti-windup. The integral then grows during the saturation, and the speed overshoots.
t = np.linspace(0, 20, 401)
gains = {"Kp": 2.0, "Ki": 1.0, "lower": -0.4, "upper": 0.4}
with_model = motor("pid", **gains, Tt=1.0).compile(["pid.Tt"])
held_back = with_model.simulate((0, 20), t)
wound_up = with_model.simulate((0, 20), t, parameters={"pid.Tt": 1e6})
overshoot = [max(run["wheel.w"].max() - 1, 0.0) for run in (held_back, wound_up)]
print(f"overshoot {overshoot[0]:.3f} with anti-windup, {overshoot[1]:.3f} without")
assert overshoot[0] < 0.01 < 0.3 < overshoot[1]

# %%
# A digital controller samples the error every half second and holds its output between samples.
sampled = motor("sampled-pi", T=0.5, Kp=0.6, Ki=0.3).compile().simulate((0, 20), t)

# %%
# The step response of :math:`\omega^2/(s^2 + 2 D \omega s + \omega^2)` agrees with its closed form.
# A delay, which four Padé stages approximate, shifts this response by one second.
w, D, T = 2.0, 0.25, 1.0
chain = cotree.Scene("chain")
chain.add("G", "transfer-function", b2=0.0, b1=0.0, b0=w**2, a1=2 * D * w, a0=w**2, u=1.0)
chain.add("late", "delay", T=T, u="G.y")
steps = chain.compile().simulate((0, 10), np.linspace(0, 10, 401), rtol=1e-10, atol=1e-12)


def closed_form(t: np.ndarray) -> np.ndarray:
    """Return the step response; zero before the step."""
    wd = w * np.sqrt(1 - D**2)
    angle = np.cos(wd * t) + D * w / wd * np.sin(wd * t)
    return np.where(t > 0, 1 - np.exp(-D * w * np.maximum(t, 0)) * angle, 0.0)


worst = np.max(np.abs(steps["G.y"] - closed_form(steps.t)))
late = np.max(np.abs(steps["late.y"] - closed_form(steps.t - T)))
print(f"largest error of the transfer function {worst:.1e}, of the Pade delay {late:.1e}")
assert worst < 1e-8  # a hundred tolerances of the run
assert late < 1e-2  # the stages are good up to 10/T; the jump of the acceleration is faster

# %%
# The drag of this wheel increases with the square of its speed. With a constant gain, the
# controller is too slow at low speed or too weak at high speed. A table therefore schedules the
# gain by the reference speed. The points of the table are parameters with sensitivities.
scene = cotree.Scene("scheduled")
scene.parameter("K_fast", 6.0)
scene.table("gain", x=[0.0, 2.0, 4.0], y=[1.0, 2.5, "K_fast"])
scene.input("wanted", "1 + where(t >= 5, 1, 0) + 2*where(t >= 10, 1, 0)")
scene.edge("wheel", "rotational_inertia", "ground", "shaft", inertia=1.0)
scene.edge("drag", "torque_source", "ground", "shaft", torque="-0.2*wheel.w*abs(wheel.w)")
scene.output("torque", "0.2*wanted**2 + gain(wanted)*(wanted - wheel.w)")
scene.edge("drive", "torque_source", "ground", "shaft", torque="torque")
model = scene.compile(["K_fast"])
scheduled = model.simulate((0, 15), np.linspace(0, 15, 301))
assert abs(scheduled["wheel.w"][-1] - 4) < 1e-3  # the feedforward is exact at rest

fig, axes = plt.subplots(2, 2, figsize=(10, 6.5), layout="constrained")
first, second, third, fourth = axes.flat
first.plot(t, held_back["wheel.w"], label="with anti-windup")
first.plot(t, wound_up["wheel.w"], "--", label="without")
first.plot(t, held_back["pid.y"], ":", label="torque with anti-windup")
first.set(title="PID with a limit of 0.4", xlabel="time [s]", ylabel="speed [rad/s], torque [N m]")
second.plot(t, sampled["wheel.w"], label="speed [rad/s]")
second.plot(t, sampled["pid.y"], drawstyle="steps-post", label="torque [N m]")
second.set(title="PI, sampled every 0.5 s", xlabel="time [s]")
third.plot(steps.t, steps["G.y"], label="transfer function")
third.plot(steps.t, steps["late.y"], label="then a delay of 1 s (Pade)")
third.plot(steps.t, closed_form(steps.t), "k:", label="closed form")
third.plot(steps.t, closed_form(steps.t - T), "k:")
third.set(title="Step response and delay", xlabel="time [s]")
fourth.plot(scheduled.t, scheduled["wheel.w"], label="speed [rad/s]")
by_gain = 10 * scheduled.sensitivity("wheel.w", "K_fast")
fourth.plot(scheduled.t, by_gain, label="10 times its derivative with respect to K_fast")
fourth.set(title="A table schedules the gain", xlabel="time [s]")
for ax in axes.flat:
    ax.legend(fontsize=8)
plt.show()
