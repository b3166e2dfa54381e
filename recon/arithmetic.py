"""The arithmetic that numbers come from: which kernels of BLAS, which instructions in NumPy, how many threads.

OpenBLAS and NumPy bring several versions of their loops and take, on each processor, the fastest. They add in another
order, so the last digit of a sum is another one, and a smoother makes 1e-7 of a sigma of it. Both can be told which to
take, by variables of the environment that are read when they are loaded.

    portable()                 the arithmetic of every x86-64 processor since 2013, unless NumPy is loaded already
    threadless()               no threads of OpenBLAS, likewise
    Arithmetic.used()          what computes here: openblas Haswell, NumPy with X86_V2 X86_V3
    arithmetic.environment()   variables of a process that computes like it, as far as the processor can
    one_thread()               linear algebra on one thread, so that a result does not hang on the number of cores

References
    OpenBLAS, README, "Setting the number of threads" and "DYNAMIC_ARCH" (OPENBLAS_CORETYPE); NumPy, "Runtime dispatch"
    (NPY_DISABLE_CPU_FEATURES).
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

_KERNEL: Final = "OPENBLAS_CORETYPE"
_WITHOUT: Final = "NPY_DISABLE_CPU_FEATURES"
_CHOSEN: Final = (_KERNEL, _WITHOUT, "NPY_ENABLE_CPU_FEATURES")
_THREADS: Final = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")
_OPENBLAS: Final = "openblas "
_NAME: Final = re.compile(r"[\w .+-]{1,80}")
_AVX512: Final = "X86_V4 AVX512_ICL AVX512_SPR"
_AVX512_BEFORE_2_4: Final = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL"
_BRINGS: Final = re.compile(r"OpenBLAS (\d+\.\d+\.\d+)")
_OVERRUNS: Final = "0.3.34"
"""OpenBLAS whose Haswell kernels write past their buffers on AMD Zen 4 and 5 (OpenMathLib/OpenBLAS#6021)."""


def portable() -> None:
    """Have NumPy and OpenBLAS, once they are loaded, compute as on a processor without AVX-512.

    Such processors give the same bytes by themselves. Nothing is done where the environment chooses, where NumPy is
    loaded already, or for a build of NumPy or SciPy that does not tell which OpenBLAS it brings.
    """
    if "numpy" in sys.modules or any(name in os.environ for name in _CHOSEN):
        return
    if _has_avx512() and all(_brings_sound_openblas(package) for package in ("numpy", "scipy")):
        from importlib.metadata import version  # slow import: only when used

        newer = tuple(int(part) for part in version("numpy").split(".")[:2]) >= (2, 4)
        os.environ[_KERNEL] = "Haswell"
        os.environ[_WITHOUT] = _AVX512 if newer else _AVX512_BEFORE_2_4


def threadless() -> None:
    """Have OpenBLAS, once it is loaded, start no threads: every step computes on one, and threads that wait for work
    take 0.1 s of each start. Nothing is done where the environment says how many, or NumPy is loaded already.
    """
    if "numpy" not in sys.modules and not any(name in os.environ for name in _THREADS):
        os.environ[_THREADS[0]] = "1"


def _has_avx512() -> bool:
    if sys.platform == "win32":
        import ctypes

        return bool(ctypes.windll.kernel32.IsProcessorFeaturePresent(41))  # PF_AVX512F_INSTRUCTIONS_AVAILABLE
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8", errors="replace") as file:
            flags = next((line for line in file if line.startswith("flags")), "")
    except OSError:
        return False
    return "avx512f" in flags.split()


def _brings_sound_openblas(package: str) -> bool:
    """Does the package say which OpenBLAS it brings, and is it one that survives being told its kernel?"""
    from importlib.util import find_spec

    spec = find_spec(package)
    if spec is None or spec.origin is None:
        return False
    try:
        told = Path(spec.origin).with_name("__config__.py").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    found = _BRINGS.search(told)
    return found is not None and found[1] != _OVERRUNS


@dataclass(frozen=True)
class Arithmetic:
    """What computes.

    blas : libraries of linear algebra with their kernels, as "openblas Haswell"
    simd : instructions that NumPy may use; threads : that linear algebra may use
    """

    blas: tuple[str, ...]
    simd: tuple[str, ...]
    threads: int

    @classmethod
    def used(cls) -> Self:
        """What computes in a step of this process."""
        from threadpoolctl import threadpool_info  # slow import: only when used

        libraries = [library for library in threadpool_info() if library["user_api"] == "blas"]
        kernels = {f"{library['internal_api']} {library.get('architecture') or ''}".strip() for library in libraries}
        simd = _simd()
        threads = max((library["num_threads"] for library in libraries), default=1) if _threads_are_told() else 1
        return cls(tuple(sorted(kernels)), (*simd.get("baseline", ()), *simd.get("found", ())), threads)

    @classmethod
    def from_data(cls, data: object) -> Self | None:
        """What `as_data` told; None where it is something else, for anybody may have written it."""
        if not isinstance(data, Mapping) or set(data) != {"blas", "simd", "threads"}:
            return None
        names = [data["blas"], data["simd"]]
        known = all(isinstance(part, list) and all(_is_name(name) for name in part) for part in names)
        return (
            cls(tuple(names[0]), tuple(names[1]), data["threads"]) if known and type(data["threads"]) is int else None
        )

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {"blas": list(self.blas), "simd": list(self.simd), "threads": self.threads}

    def __str__(self) -> str:
        threads = "" if self.threads == 1 else f", {self.threads} threads"
        return f"{' and '.join(self.blas) or 'no BLAS'}, NumPy with {' '.join(self.simd) or 'no extensions'}{threads}"

    def environment(self) -> dict[str, str]:
        """This process's environment, but with the variables that have another one compute like this.

        Instructions that NumPy does not know here, as those of another version, are left out of account.
        """
        found = {name: value for name, value in os.environ.items() if name not in (*_CHOSEN, *_THREADS)}
        kernels = [kernel.removeprefix(_OPENBLAS) for kernel in self.blas if kernel.startswith(_OPENBLAS)]
        if len(kernels) == 1:
            found[_KERNEL] = kernels[0]
        simd = _simd()
        choice = [*simd.get("found", ()), *simd.get("not found", ())]
        if {*simd.get("baseline", ()), *choice}.issuperset(self.simd):
            found[_WITHOUT] = " ".join(feature for feature in choice if feature not in self.simd)
        if self.threads != 1:
            found[_THREADS[0]] = str(self.threads)
        return found


def _is_name(text: object) -> bool:
    return isinstance(text, str) and _NAME.fullmatch(text) is not None


def _simd() -> Mapping[str, list[str]]:
    """NumPy's extensions of the processor: `baseline` that it always uses, `found`, and `not found` or switched off."""
    import numpy as np  # whoever only chooses an arithmetic must not load it

    told: Any = np.show_config(mode="dicts")
    return dict(told.get("SIMD Extensions", {}))


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold linear algebra to one thread inside, unless the environment says how many it may use.

    A BLAS library that shares a product out among threads adds in an order that depends on their number, and older
    ones even on how busy the machine is. The matrices of a drive are small, so threads gain nothing, and with several
    processes side by side they stand in each other's way.
    """
    if _threads_are_told():
        yield
        return
    from threadpoolctl import threadpool_limits  # slow import: only when used

    with threadpool_limits(limits=1, user_api="blas"):
        yield


def _threads_are_told() -> bool:
    """By somebody who wants more than the one that is usual here."""
    return any(os.environ.get(name, "1") != "1" for name in _THREADS)
