"""``python -m symo_exp``: one run, or a sweep of runs; ``record`` makes recordings.

Exit codes: 0 all done, 1 a run failed or a search found no model, 2 bad input, 130 and 143
interrupted and terminated.
PyTorch and the like take seconds to import, so they are imported where they are needed.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Sequence

from symo_exp.errors import ConfigError, debugging, first_line
from symo_exp.process import readers, stopping


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        return _execute(argv)
    except ConfigError as error:
        if debugging():
            traceback.print_exc()
        print(f"symo_exp: error: {error}", file=sys.stderr)
        return 2
    except Exception as error:
        if debugging():
            raise
        told = f"{type(error).__name__}: {first_line(error)}"
        print(f"symo_exp: {told} (SYMO_EXP_DEBUG=1 shows where)", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("symo_exp: interrupted", file=sys.stderr)
        return 130
    except stopping.Interrupted as error:
        print(f"symo_exp: {error}", file=sys.stderr)
        return 128 + error.signum


def _execute(argv: list[str]) -> int:
    if "--version" in argv:
        from importlib.metadata import version

        print(f"symo_exp {version('symo_exp')}")
        return 0
    if argv[:1] == ["record"]:
        from symo_exp.record import main as record

        return record(argv[1:])
    from symo_exp.cli.command import Command, execute_all

    command = Command(argv)
    if command.help:
        from symo_exp.cli.help import help_text

        print(help_text(command.folders), end="")
        return 0
    codes = execute_all(command.checked())
    return next((code for code in codes if code), 0)


if __name__ == "__main__":
    from symo_exp.__main__ import main as main_by_name  # so that worker processes find its parts

    readers.outlive()
    sys.exit(main_by_name())
