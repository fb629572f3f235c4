"""
Rectifier from a SPICE netlist
==============================

This example reads the SPICE netlist of a bridge rectifier with a floating source. The values of the
elements become parameters, whose names select the sensitivities.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import cotree

netlist = """bridge rectifier
Vs a b SIN(0 10 50)
Rs a a1 1
D1 a1 p dm
D2 b  p dm
D3 0 a1 dm
D4 0 b  dm
C1 p 0 100u
RL p 0 1k
Rg b 0 1meg
.model dm D(IS=1e-14)
.options gmin=1e-16
.tran 0.1m 40m uic
.end
"""
with TemporaryDirectory() as folder:
    path = Path(folder, "rectifier.cir")
    path.write_text(netlist, encoding="utf-8")
    scene = cotree.read_spice(path)
scene.output("load", "p.v")
scene.output("source", "a.v - b.v")
model = scene.compile(["C1"])
t = np.linspace(0, 0.04, 2001)
result = model.simulate((0, 0.04), t, rtol=1e-10, atol=1e-12)

fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(1e3 * t, result["source"], lw=1, color="0.6", label="source")
top.plot(1e3 * t, result["load"], label="load")
top.set(ylabel="voltage [V]")
top.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
# This is the effect of one additional microfarad:
bottom.plot(1e3 * t, 1e-6 * 1e3 * result.sensitivity("load", "C1"), color="tab:green")
bottom.set(xlabel="time [ms]", ylabel="∂ load / ∂ C1 [mV/μF]")
plt.show()

# %%
# ngspice 39.3 gives 8.139467421 V at 40 ms with steps of at most 0.5 μs and reltol 1e-6. With a
# smaller conductance across the junctions (gmin), this voltage changes by 1e-8 V.
print(f"{result['load'][-1]:.9f} V, ngspice 8.139467421 V")
assert abs(result["load"][-1] - 8.139467421) < 1e-7
