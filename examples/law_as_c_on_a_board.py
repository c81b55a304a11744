# %% [markdown]
# # A law as C on a board
#
# *My hoist has a law with a safety filter, which I tried in Python. How do I run the same law on a
# microcontroller, and how do I know that it is the same?*
#
# `hf.export_c` writes the law as C99: one file that allocates no memory. Here it is compiled for
# this computer, fed with the measurements of a run, and compared with Python bit for bit.

# %%
import shutil
import subprocess
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

SAMPLE_TIME = 0.02  # s

hoist = hf.System(
    name="hoist",
    states=(hf.Quantity("h", "m", "height of the load"), hf.Quantity("v", "m/s", "its speed")),
    inputs=(hf.Quantity("a", "m/s^2", "acceleration"),),
    rates={"h": "v", "v": "a"},
    input_bounds=hf.Box((-1.5,), (1.5,)),
)
h = hf.symbol("h")
shaft = hf.Region(
    "shaft", hoist.states[:1], (hf.Inequality("roof", h - 8, "m"), hf.Inequality("floor", -h, "m"))
)
mine = hf.Law(
    "go_up",
    hoist.states,
    {"a": "gain*(7.9 - h) - 0.6*v"},
    parameters=(hf.Parameter("gain", "1/s^2", value=0.8),),
)
law = hf.safeguard(hoist, mine, shaft, gains=(1, 4))

# %% [markdown]
# ## The run in Python
# `hf.Controller` is called once a sample, as the board will be. My law alone passes the roof.

# %%
controller, plant = hf.Controller(hoist, law), hf.Plant(hoist, [0.5, 0.0])
seen, commands = [], []
for _ in range(600):  # 12 s
    seen.append(plant.state)
    commands.append(controller.step(plant.state).input)
    plant.step(commands[-1])
seen, commands = np.array(seen), np.array(commands)
alone = hf.simulate(hoist, mine, starts=seen[:1], region=shaft, horizon=12)
print(f"highest: {seen[:, 0].max():.3f} m; by my law alone: {alone.outcomes}")
assert seen[:, 0].max() < 8
assert alone.viable == 0

# %% [markdown]
# ## The law as C
# The board calls `hoist_start` once and `hoist_step` at every sample. Around them stands what reads
# the sensors and drives the motor: here a program that reads and writes numbers as they are.

# %%
Path("hoist.h").write_text(hf.export_c_header(hoist, law, "hoist"))
Path("hoist.c").write_text(hf.export_c(hoist, law, "hoist"))
Path("board.c").write_text(r"""
#include <stdio.h>
#include "hoist.h"

int main(void)
{
    hoist_state state;
    double seen[HOIST_SEEN], command[HOIST_INPUTS], actuators[HOIST_ACTUATORS];
    long k;
    hoist_start(&state);
    for (k = 0; fread(seen, sizeof seen, 1, stdin) == 1; k++) {
        hoist_step(&state, 0.02 * k, 0.02, seen, hoist_parameters, command, actuators);
        fwrite(command, sizeof command, 1, stdout);
    }
    fprintf(stderr, "state of the law: %d bytes\n", (int) sizeof state);
    return 0;
}
""")
source = Path("hoist.c").read_text()
print("\n".join(source.splitlines()[:8]))
print(f"{len(source.splitlines())} lines in all")
assert "malloc" not in source  # no heap

# %% [markdown]
# ## Compiled with warnings as errors, and compared to the last bit

# %%
compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
if compiler is None:
    print(
        "There is no C compiler on this computer: the files are written, and nothing is compared."
    )
else:
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *flags, "board.c", "hoist.c", "-lm", "-o", "board"], check=True)
    ran = subprocess.run(["./board"], input=seen.tobytes(), capture_output=True, check=True)
    print(ran.stderr.decode().strip())
    assert ran.stdout == commands.tobytes()
    print(f"{len(commands)} commands of C and of Python are equal, bit for bit")

# %%
figure, (height, push) = plt.subplots(2, 1, sharex=True, figsize=(6.4, 5))
time = SAMPLE_TIME * np.arange(len(seen))
data = alone.dataset
height.axhspan(8, 9.2, color="0.8", label="roof")
height.plot(data["time"], data["state"].values[0, :, 0], "--", label="my law alone")
height.plot(time, seen[:, 0], label="with the safety filter")
height.set(ylabel="height h [m]", ylim=(0, 9.2))
height.legend(loc="lower right")
push.plot(data["time"], data["input"].values[0, :, 0], "--")
push.step(time, commands[:, 0], where="post")
push.set(xlabel="time [s]", ylabel="acceleration a [m/s^2]")
figure.tight_layout()
plt.show()
