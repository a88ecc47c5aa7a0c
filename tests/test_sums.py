# SPDX-License-Identifier: GPL-3.0-or-later
"""The lower houses use only sums and lengths whose last bits do not depend on the Python version or the C library.

Since 3.12 the builtin `sum` compensates the rounding of floats; `add_up` of `view/linear.py` replaces it. `sum` is only
for integers, with visible types: each term is `int(...)`, `len(...)` or `....nbytes`, or the argument is `map(int,
...)` or `map(len, ...)`.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FORBIDDEN = {
    *("math.hypot", "math.dist", "math.sumprod", "math.pow", "np.hypot", "np.dot", "np.einsum", "np.matmul"),
    *("np.linalg.norm", "np.linalg.inv", "np.linalg.solve", "np.linalg.svd", "np.linalg.det"),
    *("statistics.mean", "statistics.fmean", "statistics.stdev", "statistics.variance"),
}
# A text without these has no fault. Decorators have no space behind the @.
MAY_BE_FAULT = re.compile(r"\bsum\b|@\s|\b(?:" + "|".join(name.split(".")[-1] for name in FORBIDDEN) + r")\b")
FILES = sorted(path for house in ("kernels", "cbt_terrain") for path in (ROOT / house).rglob("*.py"))


def is_integer(term: ast.expr) -> bool:
    """Tell whether the text of a term says that it is an integer: int(...), perhaps shifted, len(...) or .nbytes."""
    if isinstance(term, ast.BinOp) and isinstance(term.op, ast.LShift):
        return is_integer(term.left)
    if isinstance(term, ast.Call):
        return isinstance(term.func, ast.Name) and term.func.id in ("int", "len")
    return isinstance(term, ast.Attribute) and term.attr == "nbytes"


def adds_integers(call: ast.Call) -> bool:
    """Tell whether a call of the builtin `sum` says that it adds integers."""
    terms = call.args[0] if call.args else None
    if isinstance(terms, ast.GeneratorExp | ast.ListComp):
        return is_integer(terms.elt)
    is_map = isinstance(terms, ast.Call) and ast.unparse(terms.func) == "map"
    return is_map and ast.unparse(terms.args[0]) in ("int", "len")


def faults_of(text: str) -> list[str]:
    """Return the calls and products in a module's text that are forbidden."""
    found = []
    for node in ast.walk(ast.parse(text)) if MAY_BE_FAULT.search(text) else ():
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name in FORBIDDEN or name.startswith("np.hypot.") or (name == "sum" and not adds_integers(node)):
                found.append(ast.unparse(node))
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            found.append(ast.unparse(node))
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_floats_are_not_added_by_the_builtin_sum(path):
    assert faults_of(path.read_text(encoding="utf-8")) == []


def test_the_rule_finds_every_forbidden_form():
    wrong = ["sum(x)", "sum(a * b for a, b in c)", "sum([x.width])", "sum(map(f, x))", "np.hypot(a, b)", "a @ b"]
    right = [
        "sum(int(x) for x in y)",
        "sum(map(len, y))",
        "sum([len(x) for x in y])",
        "sum(a.nbytes for a in b)",
        "np.sum(x)",
    ]
    assert [faults_of(text) != [] for text in wrong + right] == [True] * len(wrong) + [False] * len(right)
