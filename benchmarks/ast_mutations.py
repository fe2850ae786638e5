"""Mutations: small changes of a Python file that its tests should notice.

Each mutation replaces the text of one syntax node. Docstrings, annotations, decorators, strings, f-strings and
`if TYPE_CHECKING` are never changed.
"""

import ast
import copy
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutation:
    """One changed node.

    line: its line, counted from 1.
    before, after: the source of the node.
    source: the whole file with the change.
    """

    line: int
    before: str
    after: str
    source: str


def find_mutations(source: str) -> Iterator[Mutation]:
    """Yield all mutations of a file, in the order of its nodes."""
    for node in _changeable_nodes(ast.parse(source)):
        for changed in _changes(node):
            before = ast.get_source_segment(source, node)
            after = ast.unparse(ast.fix_missing_locations(changed))
            if before is None or before == after:
                continue
            is_expression = isinstance(node, ast.expr)
            mutated = _replace(source, node, f"({after})" if is_expression else after)
            if _is_valid(mutated):
                yield Mutation(node.lineno, before, after, mutated)


def _changeable_nodes(node: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    """The node and its descendants, without the parts that are never changed."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return
    if isinstance(node, ast.JoinedStr):
        return
    if isinstance(node, ast.expr | ast.stmt):
        yield node
    unchanged = {"annotation", "returns", "decorator_list", "bases", "keywords"}
    is_definition = isinstance(node, ast.FunctionDef | ast.ClassDef)
    for name, value in ast.iter_fields(node):
        if name in unchanged and (is_definition or name in ("annotation", "returns")):
            continue
        if isinstance(node, ast.Raise):
            continue  # its message; the statement itself is removed
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _changeable_nodes(child)


def _changes(node: ast.expr | ast.stmt) -> Iterator[ast.AST]:
    """The changed forms of one node."""
    match node:
        case ast.Compare():
            for index, operator in enumerate(node.ops):
                yield _with(node, ops=[*node.ops[:index], COMPARISONS[type(operator)](), *node.ops[index + 1 :]])
        case ast.BoolOp():
            yield _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert()):
            yield node.operand
        case ast.BinOp(op=ast.MatMult()):
            yield _with(node, left=node.right, right=node.left)
        case ast.BinOp() if type(node.op) in OPERATORS:
            yield _with(node, op=OPERATORS[type(node.op)]())
        case ast.Constant(value=bool()):
            yield ast.Constant(not node.value)
        case ast.Constant(value=int() | float()):
            yield ast.Constant(node.value + 1)
            if isinstance(node.value, float) and node.value:
                yield ast.Constant(node.value * 1.1)
        case ast.Call():
            yield from _call_changes(node)
        case ast.If() | ast.IfExp() | ast.While() if not isinstance(node.test, ast.Compare | ast.BoolOp | ast.UnaryOp):
            yield _with(node, test=ast.UnaryOp(ast.Not(), node.test))
        case ast.Raise() | ast.AugAssign():
            yield ast.Pass()
        case ast.Expr(value=ast.Call() | ast.Yield()):
            yield ast.Pass()
        case ast.Return(value=ast.expr()) if not isinstance(node.value, ast.Constant):
            yield ast.Return(ast.Constant(None))
        case ast.Break():
            yield ast.Continue()


def _call_changes(node: ast.Call) -> Iterator[ast.AST]:
    """Two arguments swapped, one keyword argument left out, min for max, or the argument instead of the call."""
    if len(node.args) > 1:
        yield _with(node, args=[node.args[1], node.args[0], *node.args[2:]])
    for index, keyword in enumerate(node.keywords):
        if keyword.arg is not None:
            yield _with(node, keywords=[*node.keywords[:index], *node.keywords[index + 1 :]])
    if isinstance(node.func, ast.Name) and node.func.id in NAMES:
        yield _with(node, func=ast.Name(NAMES[node.func.id]))
    if len(node.args) == 1 and not node.keywords and not isinstance(node.args[0], ast.Starred | ast.GeneratorExp):
        yield node.args[0]
    elif not node.args and not node.keywords and isinstance(node.func, ast.Attribute):
        yield node.func.value


def _with(node: ast.AST, **fields: object) -> ast.AST:
    """A copy of a node with other fields."""
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _replace(source: str, node: ast.expr | ast.stmt, text: str) -> str:
    """The source with the text of a node replaced. Later lines of the text get the node's indentation."""
    lines = source.encode().splitlines(keepends=True)
    assert node.end_lineno is not None
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + (node.end_col_offset or 0)
    indented = text.replace("\n", "\n" + " " * node.col_offset)
    encoded = source.encode()
    return (encoded[:start] + indented.encode() + encoded[end:]).decode()


def _is_valid(source: str) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # for example, for a call on a number
        try:
            compile(source, "mutated", "exec")
        except (SyntaxError, ValueError):
            return False
    return True
