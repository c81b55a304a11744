"""The ways through a scalar function: where it returns, and which variables have a value."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Iterator, Sequence


def uncertain(
    statements: Iterable[ast.stmt], known: set[str], variables: Collection[str]
) -> Iterator[ast.Name]:
    """The uses of variables that may have no value yet. `known` becomes what has one afterwards."""

    def read(node: ast.AST) -> Iterator[ast.Name]:
        for one in ast.walk(node):
            if isinstance(one, ast.Name) and one.id in variables and one.id not in known:
                yield one

    for node in statements:
        match node:
            case ast.If(test=test, body=body, orelse=other):
                yield from read(test)
                ways = (set(known), set(known))
                for way, part in zip(ways, (body, other), strict=True):
                    yield from uncertain(part, way, variables)
                ends = [w for w, part in zip(ways, (body, other), strict=True) if not leaves(part)]
                known |= set.intersection(*ends) if ends else ways[0]
            case ast.While(test=test, body=body):
                yield from read(test)
                yield from uncertain(body, set(known), variables)
            case ast.For(target=target, iter=bounds, body=body):
                yield from read(bounds)
                yield from uncertain(body, {*known, ast.unparse(target)}, variables)
            case ast.Assign(targets=targets, value=value):
                yield from read(value)
                for target in targets:
                    parts = target.elts if isinstance(target, ast.Tuple) else [target]
                    known |= {p.id for p in parts if isinstance(p, ast.Name)}
                    yield from read(target)
            case _:
                yield from read(node)


def leaves(statements: Sequence[ast.stmt]) -> bool:
    """Whether what follows the statements is never reached."""
    last = statements[-1] if statements else None
    return isinstance(last, ast.Break | ast.Continue) or returns(statements)


def returns(statements: Sequence[ast.stmt]) -> bool:
    """Whether the statements always end with a return."""
    match statements[-1] if statements else None:
        case ast.Return():
            return True
        case ast.If(body=body, orelse=other):
            return returns(body) and returns(other)
        case ast.While(test=ast.Constant(value=True), body=body):
            return not breaks(body)
    return False


def breaks(statements: Sequence[ast.stmt]) -> bool:
    """Whether the loop that has these statements may be left by a break."""
    return any(
        isinstance(one, ast.Break)
        or (isinstance(one, ast.If) and (breaks(one.body) or breaks(one.orelse)))
        for one in statements
    )
