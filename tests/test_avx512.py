"""MKL's AVX-512 code is used on processors of AMD where it is asked for, and nowhere else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from symo_exp import avx512

PROCESSOR = "vendor_id : {}\nflags : fpu {}\n"
AMD = PROCESSOR.format("AuthenticAMD", "avx2 avx512f")
OTHERS = {
    "of Intel": PROCESSOR.format("GenuineIntel", "avx2 avx512f"),
    "without AVX-512": PROCESSOR.format("AuthenticAMD", "avx2"),
}
CPUINFO = Path("/proc/cpuinfo")
HERE = CPUINFO.exists() and avx512.leaves_avx512_unused(CPUINFO.read_text(encoding="utf-8"))
CODE = """
import ctypes, pathlib, torch
(library,) = pathlib.Path(torch.__file__).parent.glob("lib/libtorch_cpu.*")
x = torch.rand(256, 128, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
print(ctypes.CDLL(str(library)).mkl_serv_cpu_detect(), (x @ x.T - 1).norm().item())
"""


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """Libraries that are loaded, in a process without PyTorch and with an empty cache."""
    loaded = []
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.setattr(avx512.ctypes, "CDLL", lambda path, mode: loaded.append(Path(path)))
    return loaded


def described(folder: Path, text: str) -> Path:
    file = folder / "cpuinfo"
    file.write_text(text)
    return file


@pytest.mark.parametrize("text", OTHERS.values(), ids=OTHERS)
def test_other_processors_are_left_as_they_are(text, asked, tmp_path):
    assert not avx512.use_avx512(described(tmp_path, text))
    assert not avx512.use_avx512(tmp_path / "missing")
    assert not asked
    assert not (tmp_path / "cache").exists()


def test_the_library_is_compiled_once(asked, tmp_path):
    assert avx512.use_avx512(described(tmp_path, AMD))
    made = asked[0].stat().st_mtime_ns
    assert avx512.use_avx512(described(tmp_path, AMD))
    assert asked[0] == asked[1]
    assert asked[1].stat().st_mtime_ns == made


@pytest.mark.parametrize(
    ("reason", "word"), [("torch", "before torch"), ("compiler", "no C compiler")]
)
def test_a_warning_says_why_avx512_is_not_used(reason, word, asked, tmp_path, monkeypatch, caplog):
    if reason == "torch":
        monkeypatch.setitem(sys.modules, "torch", sys)
    else:
        monkeypatch.setenv("PATH", str(tmp_path))
    assert not avx512.use_avx512(described(tmp_path, AMD))
    (line,) = caplog.messages
    assert word in line
    assert not asked


@pytest.mark.skipif(not HERE, reason="a processor of AMD with AVX-512")
def test_mkl_uses_its_other_code_only_where_it_is_asked_for(tmp_path):
    def run(switch: str) -> tuple[int, float]:
        done = subprocess.run(
            [sys.executable, "-c", f"import symo_exp\n{CODE}"], capture_output=True, text=True,
            env=os.environ | {"SYMO_EXP_AVX512": switch, "XDG_CACHE_HOME": str(tmp_path)},
        )  # fmt: skip
        assert not done.stderr
        code, size = done.stdout.split()
        return int(code), float(size)

    (plain, size), (asked, other) = run("0"), run("1")
    assert asked != plain
    assert other == pytest.approx(size, rel=1e-14)
