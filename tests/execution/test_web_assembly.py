"""The loop as a module of WebAssembly, in a second implementation of it: its bits, its exports."""

import ctypes

import numpy as np
import pytest
import wasmtime

import holdfast as hf
from holdfast.analysis.simulation.web_loop import web_loop
from holdfast.execution.simulation.settings import Settings
from holdfast.execution.web_assembly import LANES, STACK


class Instance:
    """A module with a memory; places in it are numbers of bytes."""

    def __init__(self, module, pages=64):
        self.store = wasmtime.Store()
        memory = wasmtime.Memory(self.store, wasmtime.MemoryType(wasmtime.Limits(pages, None)))
        kinds = {
            "__linear_memory": memory,
            "__stack_pointer": wasmtime.Global(
                self.store,
                wasmtime.GlobalType(wasmtime.ValType.i32(), True),
                wasmtime.Val.i32(STACK),
            ),
        }
        compiled = wasmtime.Module(self.store.engine, module)
        self.exports = wasmtime.Instance(
            self.store, compiled, [kinds[i.name] for i in compiled.imports]
        ).exports(self.store)
        size = pages * 65536
        raw = (ctypes.c_ubyte * size).from_address(
            ctypes.addressof(memory.data_ptr(self.store).contents)
        )
        self.f = np.frombuffer(raw, dtype=np.float64)
        self.i = np.frombuffer(raw, dtype=np.int64)

    def call(self, name, *arguments):
        return self.exports[name](self.store, *arguments)


@pytest.mark.few("ch2-unicycle")
@pytest.mark.parametrize("name", ["ch2-unicycle", "inspection", "a current that wanders"])
def test_two_runs_have_the_bits_of_simulate(name):
    changes = ["run.horizon=6"]
    if name == "a current that wanders":
        name, changes = "inspection", [*changes, "disturbance.Vx=0.1 + wiener(0.02)"]
    scenario = hf.load_scenario(name, changes, 2)
    settings = Settings(
        **{k: v for k, v in scenario.settings.items() if k in Settings.__dataclass_fields__}
    )
    loop = web_loop(
        scenario.system, scenario.law, settings, region=scenario.region, goal=scenario.goal,
        disturbance=scenario.disturbance if changes[1:] else None,
    )  # fmt: skip
    found = scenario.run().arrays["state"].values
    one, at = Instance(loop.exact), loop.layout.at
    w, s = STACK // 8, STACK // 8 + len(loop.numbers) + loop.records * loop.layout.record * LANES
    one.f[w : w + len(loop.numbers)] = loop.numbers
    one.i[s : s + len(loop.whole)] = loop.whole
    said = loop.described()
    one.i[s + said["entry_of_log_at"]] = 8 * (w + said["log"])
    one.i[s + said["entry_of_rings_at"]] = 8 * (w + said["rings"])
    values = [
        *(p.value for p in loop.program.parameters),
        *loop.program.given,
        settings.sample_time,
    ]
    for of in ("plant", "gains"):
        for row, value in enumerate(values):
            one.f[w + at[of] + row * LANES :][:LANES] = value
    for row in range(found.shape[2]):
        one.f[w + at["q"] + row * LANES :][:LANES] = found[:, 0, row]
    one.f[w + at["alive"] :][:LANES] = 1.0
    stop = s + len(loop.whole)
    for number, half in zip(("seed_low", "seed_high"), (settings.seed, 0), strict=True):
        one.f[w + at[number] :][:LANES] = half
    one.f[w + at["run"] :][:LANES] = range(LANES)
    one.i[s + said["entry_of_records"]] = loop.records - 1
    for function in ("begin", "advance", "finish"):
        one.call(f"holdfast_{function}", 8 * w, 8 * s, 0, 8 * stop)
    log = one.f[w + len(loop.numbers) :][: loop.records * loop.layout.record * LANES]
    rows = log.reshape(loop.records, loop.layout.record, LANES)[:, loop.layout.records["state"]]
    np.testing.assert_array_equal(rows.transpose(2, 0, 1), found)
