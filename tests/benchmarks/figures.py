"""The comparisons of the thesis, made anew with recon's own stages: a PNG and an SVG each, and the numbers behind.

    python tests/benchmarks/figures.py --out DIR [--logs FOLDER] [--quick]

FOLDER holds the real logs (by default what RECON_TEST_DATA names); without it the figure of the real crash is left
out. All else is simulated, so that the truth is known. Times of rotations are of this machine.

References
    Thesis, sections 2.2.4, 4.1, 4.4, 4.5, chapter 6 and section 9.1.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure
from thesis_figures import bases, drive, integration, rotations, sensors, symplectic
from thesis_figures.style import STYLE, Number

Draw = Callable[[], tuple[Figure, list[Number]]]

CRASH_LOG = Path("physycom_crash", "crash_01.txt")


def figures(logs: Path | None, quick: bool) -> dict[str, Draw]:
    """Every figure by the name of its files; with `quick` short drives and few vectors."""
    drive_s, rest_s, vectors, steps = (90.0, 60.0, 1_000, 1_000) if quick else (300.0, 600.0, 100_000, 40_000)
    tilted, driven = sensors.Tilted(drive_s), drive.City(drive_s)
    found: dict[str, Draw] = {
        "fig_4_1_gnss_at_rest": lambda: sensors.gnss_at_rest(rest_s),
        "fig_4_3_vertical_alignment": lambda: sensors.vertical_alignment(tilted),
        "fig_4_5_horizontal_alignment": lambda: sensors.horizontal_alignment(tilted),
        "fig_6_1_synthetic_trajectory": integration.synthetic_trajectory,
        "fig_6_2_integration_error": integration.integration_error,
        "fig_6_4_city_path": lambda: drive.path(driven),
        "fig_6_6_smoothness": lambda: drive.smoothness(driven),
        "fig_6_7_height": lambda: drive.height(driven),
        "fig_9_1_bases": bases.bases,
        "fig_9_1_symplectic": lambda: symplectic.symplectic(steps),
        "fig_2_2_4_rotations": lambda: rotations.times(vectors),
    }
    if logs is not None:
        log = logs / CRASH_LOG
        found["fig_6_3_parabola_and_trapezoid"] = lambda: integration.parabola_and_trapezoid(log)
    return dict(sorted(found.items()))


def save(figure: Figure, folder: Path, name: str) -> None:
    """NAME.png and NAME.svg; the same bytes for the same figure."""
    figure.savefig(folder / f"{name}.png", metadata={"Software": None})
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})


def show(name: str, numbers: Iterable[Number]) -> None:
    """Print a figure's name and its numbers."""
    print(name)
    for number in numbers:
        print(f"  {number.what:<58} {number.value:>9.4g} {number.unit}".rstrip(), flush=True)


def main() -> None:
    """Make the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the figures")
    parser.add_argument("--logs", type=Path, default=os.environ.get("RECON_TEST_DATA"), help="folder of the real logs")
    parser.add_argument("--quick", action="store_true", help="short drives and few vectors: a test of the command")
    options = parser.parse_args()
    if options.logs is not None and not (options.logs / CRASH_LOG).is_file():
        parser.error(f"there is no {CRASH_LOG.as_posix()} in {options.logs}")
    options.out.mkdir(parents=True, exist_ok=True)
    with rc_context(STYLE):
        for name, draw in figures(options.logs, options.quick).items():
            figure, numbers = draw()
            save(figure, options.out, name)
            show(name, numbers)
    if options.logs is None:
        print("Figure 6.3 is left out: neither --logs nor RECON_TEST_DATA names the folder of the real crash log.")


if __name__ == "__main__":
    main()
