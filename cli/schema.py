"""`duospacenet schema`: JSON Schemas of the files that other programs read and write."""

import sys
from typing import Annotated, Literal

import typer

from .options import INPUT, OUTPUT

NameArgument = Annotated[
    Literal["manifest", "results", "scene", "expected"],
    typer.Argument(
        metavar="NAME",
        help="manifest: manifest.json of a bundle. results: a line of results.jsonl. scene: scene.json of a scene "
        "folder. expected: golden/expected.json of a bundle.",
        rich_help_panel=INPUT,
    ),
]
SchemaVersionOption = Annotated[
    int | None,
    typer.Option(
        help="Schema version of the file. Default: the newest. manifest has 1 to 5, the others have 1.",
        metavar="N",
        rich_help_panel=OUTPUT,
    ),
]


def schema(name: NameArgument, schema_version: SchemaVersionOption = None) -> None:
    """Print the JSON Schema (draft 2020-12) of a file.

    \b
    Example:
      duospacenet schema manifest > manifest.schema.json
    """
    from ..jobs.json_schemas import schema_text

    sys.stdout.write(schema_text(name, schema_version))
