"""recon as a process beside Blender, with the packages that travel in the extension.

Blender since 4.2 installs the wheels that the manifest names. NumPy is not among them: Blender has its own, which is
older than recon needs up to 4.3, and must not be replaced. So the wheel of NumPy, and in an older Blender all of them,
are unpacked beside this module, where only the process of recon finds them.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import zipfile
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Final

IN_THE_PANEL: Final = "here settings go into Result > More, without --set"
_STEP: Final = re.compile(r"\[(\d+)/(\d+)\] (.*)")


@dataclass(frozen=True)
class Packages:
    """recon and what it needs: wheels in the folder of the extension."""

    root: Path

    def pipelines(self) -> set[str]:
        """Names of the pipelines in recon's wheel."""
        inside = [name for wheel in self._wheels("recon_dynamics-") for name in zipfile.ZipFile(wheel).namelist()]
        return {Path(name).stem for name in inside if re.fullmatch(r"recon/pipelines/\w+\.yaml", name)}

    def search_path(self) -> list[str]:
        """Folders where Python finds recon; what Blender did not install is unpacked now."""
        installed = find_spec("recon")
        unpacked = self.root / "unpacked"
        for wheel in self._wheels("" if installed is None else "numpy-"):
            done, this = unpacked / f"{wheel.stem}.done", str(wheel.stat().st_mtime_ns)
            if not done.is_file() or done.read_text(encoding="utf-8") != this:  # it was installed anew
                with zipfile.ZipFile(wheel) as archive:
                    archive.extractall(unpacked)
                done.write_text(this, encoding="utf-8", newline="\n")
        beside = [str(Path(installed.origin).parents[1])] if installed is not None and installed.origin else []
        return [str(unpacked), *beside]

    def _wheels(self, begins: str) -> list[Path]:
        return sorted((self.root / "wheels").glob(f"{begins}*.whl"))


PACKAGES: Final = Packages(Path(__file__).parents[1])


@dataclass(frozen=True)
class Work:
    """A running command of recon, and what it has said so far."""

    process: subprocess.Popen[str]
    said: list[str] = field(default_factory=list)

    @classmethod
    def start(cls, words: list[str], search_path: list[str]) -> Work:
        """Begin `recon WORDS`."""
        own = {"PYTHONPATH": os.pathsep.join(search_path), "PYTHONUTF8": "1", "PYTHONNOUSERSITE": "1"}
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "recon", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **own},
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # Windows alone has it
        )
        work = cls(process)
        threading.Thread(target=work._listen, daemon=True).start()
        return work

    def progress(self) -> tuple[float, str]:
        """Share that is done, and the step that runs."""
        steps = [found for line in self.said[:] if (found := _STEP.match(line))]
        if not steps:
            return 0.0, "starting"
        number, total, name = steps[-1].groups()
        return (int(number) - 1) / int(total), name

    def finished(self) -> bool:
        """Has it ended, well or not?"""
        return self.process.poll() is not None

    def failure(self) -> str:
        """Why it failed, in recon's own words; "" where it did not."""
        if self.process.wait() == 0:
            return ""
        first = next((row for row, line in enumerate(self.said) if "error: " in line), None)
        told = self.said[-3:] if first is None else self.said[first : first + 3]
        words = [line.replace("error: ", "", 1).strip() for line in told]
        text = "; ".join(words) or f"recon ended with exit code {self.process.returncode}"
        return f"{text}; {IN_THE_PANEL}" if "--set " in text else text

    def cancel(self) -> None:
        """End it; recon leaves nothing half-written."""
        self.process.terminate()
        self.process.wait()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                self.said.append(line.rstrip())
