"""What arrays give back is used again, where the C library is glibc."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

PROGRAM = """
import resource
from recon import memory
memory.keep_freed()
import numpy as np

def work():
    arrays = [np.ones(3 << 17) for _ in range(10)]  # 3 MB each: smaller than what NumPy asks huge pages for

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

for _ in range(3):
    work()
before = faults()
for _ in range(10):
    work()
print(faults() - before)
"""
PAGES = 10 * 10 * (3 << 20) // 4096
"""Pages that the second loop writes to."""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc can be told to keep memory")
@pytest.mark.parametrize(("told", "kept"), [({}, True), ({"MALLOC_TRIM_THRESHOLD_": "131072"}, False)])
def test_arrays_take_the_pages_of_those_before_unless_the_environment_says_else(told: dict[str, str], kept: bool):
    unset = {name: value for name, value in os.environ.items() if not name.startswith(("MALLOC_", "GLIBC_"))}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=unset | told, capture_output=True, text=True, check=True)
    assert (int(done.stdout) < 0.05 * PAGES) == kept
