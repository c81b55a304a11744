"""What an exported law says of obstacles that move: the function that hands them over, in C.

NAME_obstacles finds the pairs of discs that are nearest (`execution/obstacle_pairs.py`) and writes
their numbers behind the command; NAME_step fills the conditions of each pair by one function.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from holdfast.errors import DefinitionError
from holdfast.execution.codegen.c_printer import c_body, c_own
from holdfast.execution.codegen.closed_loop_program import ControllerProgram
from holdfast.maths.definitions.law import Repeated, Safeguard

SAID = (
    "/* Hands over the obstacles that are nearest: fills `handed` behind the command. records:",
    "   the bodies one after the other, size doubles in all; of each the number of its corners,",
    "   a radius around them, vx, vy, the acceleration that may change these, the share of this",
    "   vehicle (1, or 0.5 for one that filters too), the age of these numbers, the error of the",
    "   velocity, then x and y of each corner; in SI units. A disc has one corner. Returns how",
    "   many pairs there were, or -1 - k where the body k is faulty: NAME_step has no answer then.",
    "   */",
)


@dataclass(frozen=True)
class CObstacles:
    """The parts of an exported law that obstacles need; each: their conditions."""

    program: ControllerProgram
    each: Repeated
    name: str

    @classmethod
    def of(cls, program: ControllerProgram, name: str) -> CObstacles | None:
        """Of the law `name` in C; None if it keeps clear of none."""
        guards = program.safeguards.values()
        each = next((g.repeated for g in guards if g.repeated), None)
        if each is not None and each.found.rows_handed:
            raise DefinitionError(
                "the kernel of two vehicles is looked up in Python alone",
                expected="obstacles without a pair, for C",
            )
        return None if each is None else cls(program, each, name)

    @property
    def _numbers(self) -> int:
        return self.each.count * len(self.each.numbers)

    def declared(self) -> list[str]:
        """For the header."""
        return [*(line.replace("NAME_", f"{self.name}_") for line in SAID), f"{self._heading()};"]

    def _heading(self) -> str:
        return (
            f"long {self.name}_obstacles(const double *seen, const double *records, long size,\n"
            "        double *handed)"
        )

    def text(self) -> str:
        """The function that hands over the pairs."""
        count, of = self.each.count, self.each.found
        body = (
            f" {{\n    double pose[4], near[{2 * count}], touch[6];\n    hf_pose(seen, pose);\n"
            f"    return hf_find_pairs(hf_hull, {of.parts}, pose, 1, records, size, {count}, "
            f"{of.clearance!r}, {int(of.first)}, handed + {len(self.program.handed)} - "
            f"{self._numbers}, near, touch);\n}}"
        )
        return self._heading() + c_own(body, self.name)

    def functions(self, unpack: Mapping[str, Sequence[sp.Symbol]]) -> list[str]:
        """Those that fill the conditions of a pair, of every mode, the pose, and the hull."""
        texts = []
        for number, mode in enumerate(self.program.modes):
            guard = self.program.safeguards.get(mode)
            if guard is None or guard.repeated is None:
                continue
            texts.append(
                f"static void hf_thing{number}(double t, double sample_time, const double *seen,\n"
                "                      const double *kept, const double *p, const double *pair,\n"
                "                      double *asked) {\n"
                "    (void)t; (void)sample_time; (void)seen; (void)kept; (void)p;\n"
                + c_body({**unpack, "pair": guard.repeated.numbers}, guard.repeated.rows, "asked")
                + "\n}"
            )
        pose, hull = self.each.found.pose, self.each.found.hull
        seen = {"seen": [q.symbol for q in self.program.seen]}
        return [
            *texts,
            "static void hf_pose(const double *seen, double *pose) {\n"
            + c_body(seen, pose, "pose")
            + "\n}",
            f"static const double hf_hull[{len(hull)}] = {{{', '.join(map(repr, hull))}}};",
        ]

    def filled(self, number: int, guard: Safeguard) -> str:
        """The statements that fill the conditions of all pairs, behind the hard ones."""
        m, first = len(self.program.inputs), len(self.program.seen) - self._numbers
        return (
            f"\n        for (long k = 0; k < {self.each.count}; k++) {{\n"
            f"            const double *pair = seen + {first} + k * {len(self.each.numbers)};\n"
            f"            if (pair[0] != 0.0)\n"
            f"                hf_thing{number}(t, sample_time, seen, kept, p, pair,\n"
            f"                    asked + {m + guard.hard * (m + 1)} + k * "
            f"{self.each.conditions * (m + 1)});\n        }}"
        )
