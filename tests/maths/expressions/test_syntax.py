"""Texts are parsed by one thread at a time."""

import ast
import threading
import time

from holdfast.maths.expressions import traversal


def test_threads_parse_one_after_the_other(monkeypatch):
    within, most, parse = [], [], ast.parse

    def watched(text, mode):
        within.append(text)
        most.append(len(within))
        time.sleep(0.01)  # others would come meanwhile
        within.pop()
        return parse(text, mode=mode)

    monkeypatch.setattr(ast, "parse", watched)
    found = []
    threads = [
        threading.Thread(target=lambda k=k: found.append(traversal.syntax_tree(f"x + {k}", "eval")))
        for k in range(4)
    ]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert most == [1] * 4
    assert sorted(ast.unparse(tree) for tree in found) == [f"x + {k}" for k in range(4)]
