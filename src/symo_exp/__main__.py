"""``python -m symo_exp``: one run, or a sweep of runs.

Exit codes: 0 all done, 1 a run failed, 2 bad input, 130 and 143 interrupted and terminated.
PyTorch and the like take seconds to import, so they are imported where they are needed.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence

from symo_exp.errors import ConfigError
from symo_exp.training.stopping import Interrupted


def main(argv: Sequence[str] | None = None) -> int:
    """The command line. Returns the exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    if {"-h", "--help"} & set(argv):
        from symo_exp.configuration.help import help_text

        print(help_text(), end="")
        return 0
    if "--version" in argv:
        from importlib.metadata import version

        print(f"symo_exp {version('symo_exp')}")
        return 0
    debug = os.environ.get("SYMO_EXP_DEBUG") == "1"
    try:
        from symo_exp.launch import execute

        return execute(argv)
    except ConfigError as error:
        if debug:
            traceback.print_exc()
        print(f"symo_exp: error: {error}", file=sys.stderr)
        return 2
    except Exception as error:
        if debug:
            raise
        print(
            f"symo_exp: {type(error).__name__}: {error} (SYMO_EXP_DEBUG=1 shows where)",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print("symo_exp: interrupted", file=sys.stderr)
        return 130
    except Interrupted as error:
        print(f"symo_exp: {error}", file=sys.stderr)
        return 128 + error.signum


if __name__ == "__main__":
    from symo_exp.__main__ import main as main_by_name  # so that worker processes find its parts

    sys.exit(main_by_name())
