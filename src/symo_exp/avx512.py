"""MKL's AVX-512 code on processors of AMD, if ``SYMO_EXP_AVX512=1`` asks for it.

MKL, PyTorch's library for products of matrices, chooses its code by the maker of the processor: on
one of AMD it takes code for AVX2, also where the processor has AVX-512. A library that is loaded
before PyTorch answers MKL's question about the maker, ``mkl_serv_intel_cpu_true``, with yes. Intel
documents no setting for this. ``docs/amd.md`` tells what it gives.
"""

from __future__ import annotations

import ctypes
import logging
import shutil
import subprocess
import sys
from pathlib import Path

from symo_exp.files import user_cache, write_whole

SOURCE = "int mkl_serv_intel_cpu_true(void) { return 1; }\n"

log = logging.getLogger(__name__)


def leaves_avx512_unused(cpuinfo: str) -> bool:
    """Return whether MKL leaves the AVX-512 of a processor unused: whether it is of AMD and has it.

    Args:
        cpuinfo: Text of ``/proc/cpuinfo``.
    """
    words = set(cpuinfo.split())
    return {"AuthenticAMD", "avx512f"} <= words


def use_avx512(cpuinfo: Path = Path("/proc/cpuinfo")) -> bool:
    """Let MKL use its AVX-512 code in this process, and return whether that was arranged.

    Nothing happens on other processors. If it cannot be done, a line is logged and MKL uses the
    code that it chooses.

    Args:
        cpuinfo: Description of the processor by Linux.
    """
    if not cpuinfo.exists() or not leaves_avx512_unused(cpuinfo.read_text(encoding="utf-8")):
        return False
    if "torch" in sys.modules:  # MKL has chosen
        log.warning("SYMO_EXP_AVX512=1 has no effect: import symo_exp before torch")
        return False
    try:
        ctypes.CDLL(str(_library()), ctypes.RTLD_GLOBAL)
    except (OSError, subprocess.CalledProcessError) as error:
        log.warning("SYMO_EXP_AVX512=1 has no effect: %s", error)
        return False
    return True


def _library() -> Path:
    """Return the library, compiled at its first use."""
    path = user_cache() / "mkl_serv_intel_cpu_true.so"
    if not path.exists():
        compiler = next(filter(shutil.which, ("cc", "gcc", "clang")), None)
        if compiler is None:
            raise OSError("there is no C compiler (cc, gcc or clang)")
        command = [compiler, "-shared", "-fPIC", "-x", "c", "-", "-o"]
        write_whole(
            path,
            lambda new: subprocess.run(
                [*command, new], input=SOURCE, text=True, check=True, capture_output=True
            ),
        )
    return path
