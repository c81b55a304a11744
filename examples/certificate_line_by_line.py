# %% [markdown]
# # A certificate, read line by line
#
# *A trial of a thousand runs is no proof. What does a certificate say, what does it rest on, and
# does a second program notice when somebody changes it?*
#
# A cart between two walls is pushed by a disturbance. `hf.certify` searches for cells that held
# inputs never lead out of; `holdfast-check`, which shares no code with it, checks what it found.

# %%
import hashlib
import json
import subprocess
import sys
import zlib
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import holdfast as hf

CELLS = 61

cart = hf.System(
    name="cart",
    states=(hf.Quantity("x", "m"), hf.Quantity("v", "m/s")),
    inputs=(hf.Quantity("a", "m/s^2"),),
    disturbances=(hf.Quantity("w", "m/s^2", "push"),),
    rates={"x": "v", "v": "a + w"},
    input_bounds=hf.Box((-1,), (1,)),
    disturbance_bounds=hf.Box((-0.3,), (0.3,)),
)
x = hf.symbol("x")
walls = hf.Region(
    "walls",
    cart.states[:1],
    (hf.Inequality("left", -1 - x, "m"), hf.Inequality("right", x - 1, "m")),
)

# %% [markdown]
# ## The search
# 61 x 61 cells, of which an input that is held for 0.2 s must lead into certified ones again.

# %%
certificate = hf.certify(
    cart, walls, box={"x": (-1, 1), "v": (-1.6, 1.6)}, cells=CELLS, sample_time=0.2
)
print(f"{certificate.kept.share:.1%} of the cells between the walls are certified")
path = certificate.write(Path("cart.holdfast"))

# %% [markdown]
# ## The lines of the file
# The first line is the kind of the file and a digest (SHA-256) of the rest.

# %%
first, statement, packed = path.read_bytes().split(b"\n", 2)
print(first.decode())
assert first.split()[-1].decode() == hashlib.sha256(statement + b"\n" + packed).hexdigest()

# %% [markdown]
# The second line is the statement, in JSON: for every state of the cells, and every disturbance
# within its range, the inputs keep the constraints at or below 0. Numbers are hexadecimal, so that
# not a bit of them is lost. `holds` of null is for ever.

# %%
says = json.loads(statement)
for entry in ("title", "rates", "constraints", "disturbances", "hold", "holds", "cells_kept"):
    print(f"{entry}: {says[entry]}")
assert says["rates"] == ["v", "a + w"]
assert [float.fromhex(end) for end in says["disturbances"][0]["range"]] == [-0.3, 0.3]
assert float.fromhex(says["hold"]) == 0.2

# %% [markdown]
# The rest is packed: the number of each certified cell, and that of the input that it has.

# %%
ENTRY = [("cell", "<u4"), ("input", "<u2"), ("level", "<u4")]
entries = np.frombuffer(zlib.decompress(packed), ENTRY)
inputs = [float.fromhex(row[0]) for row in says["candidates"]]
print(f"{len(entries)} entries; cell {entries['cell'][0]} has a = {inputs[entries['input'][0]]}")
assert len(entries) == says["cells_kept"]

# %% [markdown]
# ## The check by a program of its own
# It needs `pip install 'holdfast[check]'`, and is `holdfast-check` on the command line.


# %%
def check(file):
    command = [sys.executable, "-m", "holdfast_check", str(file)]
    done = subprocess.run(command, capture_output=True, text=True)
    print((done.stdout + done.stderr).splitlines()[0])
    return done.returncode


assert check(path) == 0

# %% [markdown]
# ## One number is changed
# First by hand: the digest gives it away. Then by somebody who writes the digest anew: the proof
# does not hold for a stronger disturbance, nor with another input of a single cell.


# %%
def forged(name, statement, packed, digest=None):
    content = statement + b"\n" + packed
    digest = digest or hashlib.sha256(content).hexdigest().encode()
    Path(name).write_bytes(b"holdfast-certificate 1 " + digest + b"\n" + content)
    return name


says["disturbances"][0]["range"] = [(-0.5).hex(), (0.5).hex()]
stronger = json.dumps(says, separators=(",", ":"), sort_keys=True).encode()
changed = entries.copy()
changed["input"][0] = 0  # a = -1, away from where this cell is kept
other_input = zlib.compress(changed.tobytes())
assert check(forged("by_hand.holdfast", stronger, packed, first.split()[-1])) == 1
assert check(forged("stronger.holdfast", stronger, packed)) == 1
assert check(forged("input.holdfast", statement, other_input)) == 1

# %% [markdown]
# ## Against the exact solution
# What can be kept is known: against the worst push the cart brakes with 0.7 m/s^2, and needs
# v^2 / 1.4 m for it. Every certified cell is within that, corners included.

# %%
x_edges, v_edges = ([float.fromhex(edge) for edge in axis] for axis in says["edges"])
along_x, along_v = np.divmod(entries["cell"].astype(int), CELLS)
farthest = np.array(x_edges)[along_x + 1], np.array(v_edges)[along_v + 1]
assert (np.maximum(farthest[1], 0) ** 2 / 1.4 <= 1 - farthest[0] + 1e-12).all()

figure = hf.certificate_figure(certificate)
braking = np.linspace(0, 1.6, 100)
for side in (-1, 1):
    figure.axes[0].plot(side * (1 - braking**2 / 1.4), side * braking, "k:")
plt.show()
