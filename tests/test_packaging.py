"""Content of the wheel."""

import re
import subprocess
import sys
import zipfile

from tests.pages import ROOT


def test_the_wheel_carries_settings_and_sweeps(tmp_path):
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    carried = set(zipfile.ZipFile(wheel).namelist())
    for folder in ("conf", "sweeps"):
        for file in (ROOT / folder).rglob("*.yaml"):
            assert f"symo_exp/{file.relative_to(ROOT)}" in carried
    assert "symo_exp/__main__.py" in carried
    assert not [name for name in carried if name.startswith(("tests", "benchmarks", "recordings"))]
    assert not [name for name in carried if name.endswith(".parquet")]


def test_tested_versions_are_pinned_and_torch_without_a_build_tag():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert any(re.fullmatch(r"torch==[\d.]+", line) for line in pins)
    assert all("==" in line and "://" not in line and not line.startswith("-") for line in pins)
