"""The commands by name."""

import typer

from . import anchors, check_rig, demo, evaluate, export, inspect, parity, run, train

app = typer.Typer(
    name="duospacenet",
    help="DuoSpaceNet out of PyTorch: export to ONNX, run on a CPU, prove it equal.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("export")(export.export)
app.command("anchors")(anchors.anchors)
app.command("train")(train.train)
app.command("check-rig")(check_rig.check_rig)
app.command("run")(run.run)
app.command("eval")(evaluate.evaluate_bundle)
app.command("parity")(parity.parity)
app.command("inspect")(inspect.inspect)
