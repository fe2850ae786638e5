"""Commands in a process that must not import some modules."""

import subprocess
import sys
from collections.abc import Iterable, Sequence

# Not ImportError, which a command may catch in order to name a missing extra. The text on stderr shows an import whose
# error was caught.
_CODE = """
import sys

class Blocker:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if any(name == module or name.startswith(module + ".") for module in blocked):
            print("imported", name, file=sys.stderr)
            raise AssertionError(f"imported {name}")

blocked = sys.argv.pop().split(",")
sys.meta_path.insert(0, Blocker)
from duospacenet.cli.main import main
main()
"""


def call_without(modules: Iterable[str], arguments: Sequence[object], **options) -> subprocess.CompletedProcess:
    """Run `duospacenet ARGUMENTS`. An import of one of the modules is an error, and is reported on stderr.

    options: of `subprocess.run`; they override the defaults.
    """
    command = [sys.executable, "-c", _CODE, *map(str, arguments), ",".join(modules)]
    return subprocess.run(command, **{"capture_output": True, "text": True, "check": False} | options)
