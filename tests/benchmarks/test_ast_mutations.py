"""The mutations of a Python file."""

import pytest

from benchmarks.ast_mutations import find_mutations


def changes(source):
    return {(mutation.before, mutation.after) for mutation in find_mutations(source)}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("x = a < b <= c", {("a < b <= c", "a <= b <= c"), ("a < b <= c", "a < b < c")}),
        ("x = a and b", {("a and b", "a or b")}),
        ("x = not a", {("not a", "a")}),
        ("x = a @ b", {("a @ b", "b @ a")}),
        ("x = 3", {("3", "4")}),
        ("x = True", {("True", "False")}),
        ("x = f(a, b)", {("f(a, b)", "f(b, a)")}),
        ("x = sort(a, kind='stable')", {("sort(a, kind='stable')", "sort(a)")}),
        ("x = max(a)", {("max(a)", "min(a)"), ("max(a)", "a")}),
        ("raise ValueError(3)", {("raise ValueError(3)", "pass")}),
        ("f(a)", {("f(a)", "pass"), ("f(a)", "a")}),
        ("def f(a: int = 1) -> int:\n    '''Two.'''\n    return a\n", {("1", "2"), ("return a", "return None")}),
        ("x = f'{a + 1}'", set()),
        ("if TYPE_CHECKING:\n    x = 1", set()),
    ],
)
def test_each_kind_of_node_is_changed(source, expected):
    assert changes(source) == expected


def test_only_the_node_is_replaced_and_the_file_stays_valid():
    source = "def f(é, b):  # é takes two bytes\n    if é:\n        return g(é, b < 2)  # why\n    return None\n"
    for mutation in find_mutations(source):
        compile(mutation.source, "mutated", "exec")
        assert "# é takes two bytes" in mutation.source
    comparison = next(mutation for mutation in find_mutations(source) if mutation.after == "b <= 2")
    assert comparison.source == source.replace("b < 2", "(b <= 2)")
    assert comparison.line == 3
