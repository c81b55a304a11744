"""The text of a march for a graphics processor: its leaves, and the sweep that calls them.

The leaves are those of the march on a processor (`rate_leaves.py`, `stage_steps.py`, the schemes),
printed as C++ for a node, not as LLVM for a run of nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib import resources

from holdfast.execution.arithmetic.steps import Steps, Value
from holdfast.execution.codegen.c_printer import Body, c_functions
from holdfast.execution.codegen.llvm_text import Leaf
from holdfast.execution.codegen.lowering import FUNCTIONS
from holdfast.execution.level_set.schemes import Scheme
from holdfast.execution.level_set.stage_steps import Stage, names_of_numbers
from holdfast.execution.level_set.units import layout

MOST_NODES = 256
"""Nodes of a unit, at most."""

SHARED = 1 << 15
"""Bytes that a block of threads shares, at most."""

TABLE = "hf_real *table, hf_int pitch"
"""The results of the leaf of the last axis: rows that are `pitch` numbers apart."""


def device_layout(shape: Sequence[int], of_row: int) -> tuple[int, int, int, int]:
    """As `units.layout`: what depends on the rows of a unit is shared by a block of threads."""
    rows = max(1, SHARED // (8 * (of_row + 1)))
    return layout(shape, min(MOST_NODES, rows * shape[-1]), MOST_NODES)


def march_text(stage: Stage, scheme: Scheme, precision: str, rows: int) -> str:
    """The kernels `hf_last_axis`, `hf_stage`, `hf_measured` and `hf_mirror`.

    rows: of the last axis in a unit.
    """
    real = "float" if precision == "float32" else "double"
    rates = stage.rates
    leaves = [
        _leaf("along", rates.leaves["along"], real, "table[{} * pitch]", TABLE),
        _leaf("row", rates.leaves["rows"], "double", "of_row[{} * HF_MOST_ROWS]", "double *of_row"),
        *_scheme(scheme, precision, real),
        _node(stage, real),
    ]
    text = "\n\n".join(leaves)
    functions = c_functions(text, FUNCTIONS).replace("static inline", "HF_FUNCTION")
    named = {
        "AXES": stage.axes, "GHOSTS": scheme.ghosts, "ONE_SLOPE": int(scheme.one_slope),
        "FILTERED": int(stage.filtered), "LOWER": int(stage.lower), "UPPER": int(stage.upper),
        "FALLS": names_of_numbers(stage.axes).index("low0"),
        "ROW": rates.of_row + rates.outer,
        "MOST_ROWS": int(rows),
    }  # fmt: skip
    head = [f"#define HF_{name} {value}" for name, value in named.items()]
    sweep = (resources.files(__package__) / "device_sweep.h").read_text("utf-8")
    return "\n".join([f"typedef {real} hf_real;", *head, "", functions + text, "", sweep])


def _leaf(name: str, leaf: Leaf, real: str, place: str, into: str) -> str:
    """A leaf of nodes or rows: w its states, u what is the same everywhere."""
    body = Body(leaf.steps, leaf.results, "    ")
    used = _inputs(leaf.steps, leaf.results)
    given = {
        n: f"{a}[{k}]" for a in ("w", "u") for k, n in enumerate(leaf.arguments[a]) if n in used
    }
    ends = [
        f"    {place.format(i)} = {_cast(body.text(v.number), real)};"
        for i, v in enumerate(leaf.results)
    ]
    return "\n".join(
        [
            f"HF_FUNCTION void hf_{name}(const double *w, const double *u, {into})",
            "{",
            *_declared(given, "double"),
            *body.lines,
            *ends,
            "}",
        ]
    )


def _cast(text: str, real: str) -> str:
    return text if real == "double" else f"(hf_real)({text})"


def _scheme(scheme: Scheme, precision: str, real: str) -> Iterable[str]:
    """The slope at the upper and at the lower end of an interval, from the nodes n[0], n[1], ...

    The plain difference, which its leaf may have too, is a subtraction in `device_sweep.h`.
    """
    if scheme.one_slope:
        return
    leaf = scheme.leaf(precision, plain=False)
    for name, result in zip(("upper", "lower"), leaf.results, strict=True):
        body = Body(leaf.steps, [result], "    ", real, fused=True)
        given = {f"n{k}": f"n[{k}]" for k in range(2 * scheme.ghosts)}
        used = _inputs(leaf.steps, [result])
        yield "\n".join(
            [
                f"HF_FUNCTION hf_real hf_{name}(const hf_real *n)",
                "{",
                *_declared({k: v for k, v in given.items() if k in used}, real),
                *body.lines,
                f"    return {body.text(result.number)};",
                "}",
            ]
        )


def _node(stage: Stage, real: str) -> str:
    """From the slopes in cells on both sides of a node, and its plain differences, to its value."""
    n = stage.axes
    given = {name: f"numbers[{k}]" for k, name in enumerate(names_of_numbers(n))}
    names = [f"{x}{i}" for x in ("mean", "gap") for i in range(n)]
    lines = [
        *_declared(given, real),
        f"    {real} {', '.join(names)}, rate;",
        *_rate(stage, real, "", "rate", 0, declared=False),
    ]
    if stage.filtered:
        sides = {
            f"{kind}{x}{i}": f"{kind}{x}[{i}]"
            for kind in ("", "plain_")
            for i in range(n)
            for x in ("below", "above")
        }
        steps, results = stage.apart()
        apart = Body(steps, results, "        ", real, fused=True)
        steps, (held,) = stage.filter()
        last = Body(steps, [held], "            ", real, fused=True)
        lines += [
            "    {",
            f"    {real} {', '.join(f'speed{i}' for i in range(n))};",
            *(
                x
                for i in range(n)
                for x in _rate(stage, real, "", f"speed{i}", 2 + i, declared=True)
            ),
            *_declared(sides, real, "        "),
            *apart.lines,
            f"        if ({apart.text(results[2].number)}) {{",
            f"            const {real} apart = {apart.text(results[0].number)};",
            f"            const {real} own_leeway = {apart.text(results[1].number)};",
            f"            {real} monotone;",
            *_rate(stage, real, "plain_", "monotone", 1, declared=True),
            "            {",
            f"            const {real} leeway = own_leeway;",
            *last.lines,
            f"            rate = {last.text(held.number)};",
            "            }",
            "        }",
            "    }",
        ]
    steps, results = stage.step(measured=True)
    last = Body(steps, results, "    ", real, fused=True)
    lines += last.lines
    for name, value in zip(("new_value", "differs", "odd", "move"), results, strict=True):
        lines.append(f"    *{name} = {last.text(value.number)};")
    return "\n".join(
        [
            "HF_FUNCTION void hf_node(const double *numbers, const hf_real *along, hf_int pitch,",
            "    const double *of_row, const hf_real *below, const hf_real *above,",
            "    const hf_real *plain_below, const hf_real *plain_above, hf_real value,",
            "    hf_real base, hf_real before, hf_real lower, hf_real upper, hf_real *new_value,",
            "    int *differs, int *odd, hf_real *move)",
            "{",
            *lines,
            "}",
        ]
    )


def _rate(
    stage: Stage, real: str, kind: str, name: str, result: int, *, declared: bool
) -> list[str]:
    """A block that sets `name` to a result of the leaf of the rate, from the slopes of a kind.

    declared: whether the means and gaps are the block's own, and not those outside it.
    """
    n, rates = stage.axes, stage.rates
    rate, along = rates.rate, rates.along
    of_rate = real if rate.algebraic else "double"
    slopes, found = stage.slopes()
    means = Body(slopes, found, "            ", real, fused=True)
    names = [f"{x}{i}" for x in ("mean", "gap") for i in range(n)]
    sides = {f"{x}{i}": f"{kind}{x}[{i}]" for i in range(n) for x in ("below", "above")}
    wanted = rate.results[result]
    used = _inputs(rate.steps, [wanted])
    own: dict[str, str] = {}
    for k, argument in enumerate(rate.arguments["w"]):
        if k < along:
            own[argument] = f"along[{k} * pitch]"
        elif k < along + rates.of_row:
            own[argument] = f"(hf_real)of_row[{rates.outer + k - along} * HF_MOST_ROWS]"
        else:
            i = k - along - rates.of_row
            own[argument] = f"{'mean' if i < n else 'gap'}{i % n}"
    own |= {x: f"of_row[{k} * HF_MOST_ROWS]" for k, x in enumerate(rate.arguments["u"])}
    body = Body(rate.steps, [wanted], "            ", of_rate)
    return [
        "    {",
        *([f"        {real} {', '.join(names)};"] if declared else []),
        "        {",
        *_declared(sides, real, "            "),
        *means.lines,
        *(f"            {x} = {means.text(v.number)};" for x, v in zip(names, found, strict=True)),
        "        }",
        "        {",
        *_declared({k: v for k, v in own.items() if k in used}, of_rate, "            "),
        *body.lines,
        f"            {name} = ({real})({body.text(wanted.number)});",
        "        }",
        "    }",
    ]


def _inputs(steps: Steps, results: Sequence[Value]) -> set[str]:
    """The names of the inputs that results need."""
    needed = steps.needed([v.number for v in results])
    return {steps.list[k].given for k in needed if steps.list[k].operation == "input"}


def _declared(given: Mapping[str, str], real: str, indent: str = "    ") -> list[str]:
    return [f"{indent}const {real} {name} = ({real}){place};" for name, place in given.items()]
