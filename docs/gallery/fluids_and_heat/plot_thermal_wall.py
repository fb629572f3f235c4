"""
Transient heat conduction in a wall
===================================

One side of a wall is suddenly heated to 40 °C. Forty slices, each a heat capacity between two
thermal resistances, approximate the heat equation.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

N, thickness, conductivity, density_heat = 40, 0.2, 0.8, 1.6e6
R, C = thickness / conductivity / N, thickness * density_heat / N  # of a slice and a square metre
cold, hot = 283.15, 313.15

scene = cotree.Scene("wall")
scene.edge("left", "temperature_source", "w0", "ground", temperature=hot)
scene.edge("right", "temperature_source", f"w{N + 1}", "ground", temperature=cold)
for k in range(1, N + 1):
    scene.edge(f"C{k}", "heat_capacitor", f"w{k}", "ground", capacity=C, initial={"T": cold})
for k in range(N + 1):
    at_surface = k in (0, N)  # half a slice lies before the first node and behind the last
    resistance = R / 2 if at_surface else R
    scene.edge(f"R{k}", "thermal_resistor", f"w{k}", f"w{k + 1}", resistance=resistance)
scene.output("flow", f"R{N}.q")

hours = np.array([0.0, 0.5, 1, 2, 4, 8, 24])
result = scene.compile().simulate((0, 86400), 3600 * hours, rtol=1e-8, atol=1e-8)

x = np.concatenate([[0], (np.arange(N) + 0.5) / N, [1]])
for j, hour in enumerate(hours[1:], start=1):
    inside = [result[f"C{k}.T"][j] for k in range(1, N + 1)]
    plt.plot(100 * thickness * x, np.array([hot, *inside, cold]) - 273.15, label=f"{hour:g} h")
plt.xlabel("depth [cm]")
plt.ylabel("temperature [°C]")
plt.legend()
plt.show()

# %%
# Fourier's series gives the heat flow through the other side (H. S. Carslaw and J. C. Jaeger,
# *Conduction of Heat in Solids*, chapter 3). The discretisation is of second order: mode n decays
# too slowly by about :math:`(n \pi / N)^2 / 12`, a fraction of 5e-4 for n = 1.
modes = np.arange(1, 60)
diffusivity = conductivity / density_heat
decay = np.exp(-((modes * np.pi / thickness) ** 2) * diffusivity * 3600 * 4)
exact = conductivity / thickness * (hot - cold) * (1 + 2 * np.sum((-1.0) ** modes * decay))
found = result["flow"][4]
print(f"heat through the wall after 4 h: {found:.4f} W/m², Fourier's series {exact:.4f} W/m²")
assert abs(found / exact - 1) < 1e-3
