"""Values that several leaves of a closed loop need, computed once as rows of their own.

prepared: what depends on the parameters alone and has a quotient or a root in it; it is computed
once for each run. shared: what the leaves of several modes, and those of no mode, need of one
sample, such as the sine of a heading or the gradient of a field; it is computed once for each
sample. A leaf reads these rows behind those of its parameters `p` and of what the law sees, `q`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from holdfast.execution.arithmetic.steps import FLOAT, Step, Steps, Value
from holdfast.execution.codegen.llvm_text import Leaf

PREPARED, SHARED = "prepared", "shared"
COSTLY = frozenset(("div", "sqrt", "rare"))
FEW = 2
"""Operations that are not worth a row."""


def with_shared_rows(
    leaves: Mapping[str, Leaf], prepared: Iterable[str], users: Mapping[str, object]
) -> dict[str, Leaf]:
    """The leaves, of the same steps, with those that compute rows for several of them.

    prepared: the leaves whose parameters are rows of a block. users: the leaves that are computed
    at a sample, each with who uses it; what two users need is shared.
    """
    found = dict(leaves)
    steps = next(iter(leaves.values())).steps
    about = _About(steps)
    ready = [name for name in prepared if name in leaves]
    constant = {
        k for name in ready for k in _needed(found[name]) if about.is_prepared(k)
    }  # fmt: skip
    _cut(found, ready, constant, about, PREPARED, "p", ("p",))
    sharing = [name for name in users if name in leaves]
    by: dict[int, set[object]] = defaultdict(set)
    for name in sharing:
        for k in _needed(found[name]):
            by[k].add(users[name])
    common = {k for k, own in by.items() if len(own) > 1 and "x" not in about.reads[k]}
    _cut(found, sharing, common, about, SHARED, "q", ("t", "q", "p"))
    return found


class _About:
    """What each step depends on: the arrays that it reads, and the operations below it."""

    def __init__(self, steps: Steps) -> None:
        self.list: list[Step] = steps.list
        self.reads: list[frozenset[str]] = []
        self.costly: list[bool] = []
        self.size: list[int] = []
        for step in self.list:
            own = frozenset(step.given[0]) if step.operation == "input" else frozenset()
            self.reads.append(own.union(*(self.reads[a] for a in step.arguments)))
            below = [self.costly[a] for a in step.arguments]
            self.costly.append(step.operation in COSTLY or any(below))
            work = step.operation not in ("input", "constant")
            self.size.append(work + sum(self.size[a] for a in step.arguments))

    def is_prepared(self, k: int) -> bool:
        return self.costly[k] and self.reads[k] == {"p"}


def _needed(leaf: Leaf) -> list[int]:
    return leaf.steps.needed([v.number for v in leaf.results], leaf.read)


def _cut(
    leaves: dict[str, Leaf], names: Sequence[str], inner: set[int], about: _About, new: str,
    array: str, arguments: Sequence[str],
) -> None:  # fmt: skip
    """Let the leaves read the values of `inner` that they use from rows of the leaf `new`."""
    rows: dict[int, str] = {}
    for name in names:
        leaf = leaves[name]
        waiting, done = [v.number for v in leaf.results], set[int]()
        while waiting:
            k = waiting.pop()
            if k in done or k in leaf.read:
                continue
            done.add(k)
            step = about.list[k]
            if k in inner and step.kind == FLOAT and about.size[k] > FEW:
                rows.setdefault(k, f"{new}{len(rows)}")
            else:
                waiting.extend(step.arguments)
    if not rows:
        return
    some = leaves[names[0]]
    values = [Value(some.steps, k, FLOAT) for k in rows]
    given = {a: next(v for n in names if (v := leaves[n].arguments[a])) for a in arguments}
    given |= {a: () for a in some.arguments if a not in given}
    order = {a: given[a] for a in some.arguments}
    read = {k: row for n in names for k, row in leaves[n].read.items()}
    for name in names:
        leaf = leaves[name]
        behind = {
            **leaf.arguments,
            array: (*(leaf.arguments[array] or given[array]), *rows.values()),
        }
        leaves[name] = replace(leaf, arguments=behind, read={**leaf.read, **rows})
    leaves[new] = Leaf(some.steps, order, values, read=read)
