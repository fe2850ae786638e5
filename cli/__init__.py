"""The command line: options in, messages out. `main.py` is the entry point, `commands.py` lists the commands."""
