"""How long a law exported as C99 takes: nanoseconds a call, by the compiler of this machine.

python benchmarks/exported_law.py [--calls 2000000]
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

import holdfast as hf

NAMES = ("ch4-unicycle", "ch3-unknown-current", "ch4-chained-4", "ch5-viable-goal-set")

MAIN = """
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
int main(int argc, char **argv) {
    long calls = atol(argv[argc - 1]);
    static double rows[1024][LAW__SEEN];
    double command[LAW__INPUTS], actuators[LAW__ACTUATORS], total = 0.0;
    law__state s;
    law__start(&s);
    for (int i = 0; i < 1024; i++)
        for (int j = 0; j < LAW__SEEN; j++) rows[i][j] = 4.0 * rand() / RAND_MAX - 2.0;
    double best = 1e9;
    for (int repetition = 0; repetition < 5; repetition++) {
        struct timespec a, b;
        timespec_get(&a, TIME_UTC);
        for (long i = 0; i < calls; i++) {
            law__step(&s, 0.02 * i, 0.02, rows[i & 1023], law__parameters, command, actuators);
            total += actuators[0];
        }
        timespec_get(&b, TIME_UTC);
        double ns = ((b.tv_sec - a.tv_sec) * 1e9 + (b.tv_nsec - a.tv_nsec)) / calls;
        if (ns < best) best = ns;
    }
    printf("%.1f %g\\n", best, total);
    return 0;
}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=2_000_000)
    calls = parser.parse_args().calls
    print("| law of | modes | lines | ns a call |\n|---|---|---|---|")
    for name in NAMES:
        scenario = hf.load_scenario(name)
        text = hf.export_c(scenario.system, scenario.law, "law_")
        with tempfile.TemporaryDirectory() as folder:
            source, program = Path(folder) / "law.c", Path(folder) / "law"
            source.write_text(text + MAIN)
            subprocess.run(
                ["gcc", "-std=c11", "-O2", str(source), "-o", str(program), "-lm"], check=True
            )
            done = subprocess.run([program, str(calls)], capture_output=True, text=True, check=True)
        modes = len(getattr(scenario.law, "modes", [1]))
        print(f"| `{name}` | {modes} | {len(text.splitlines())} | {done.stdout.split()[0]} |")


if __name__ == "__main__":
    main()
