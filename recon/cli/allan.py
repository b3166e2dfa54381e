"""`recon allan`: the noise of an IMU from a record of it standing still."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, Settings, bad_option, overrides_of, registry_of

if TYPE_CHECKING:
    from recon.allan import Allan

_TERMS: Final = {
    "gyro": (
        ("white noise", "white", "rad/s/sqrt(Hz)", "deg/s/sqrt(Hz)"),
        ("angle random walk", "white", "rad/s/sqrt(Hz)", "deg/sqrt(h)"),
        ("bias instability", "instability", "rad/s", "deg/h"),
        ("rate random walk", "walk", "rad/s/sqrt(s)", "deg/s/sqrt(s)"),
        ("quantisation", "quantisation", "rad", "deg"),
    ),
    "accel": (
        ("white noise", "white", "m/s^2/sqrt(Hz)", "ug/sqrt(Hz)"),
        ("velocity random walk", "white", "m/s^2/sqrt(Hz)", "m/s/sqrt(h)"),
        ("bias instability", "instability", "m/s^2", "ug"),
        ("acceleration random walk", "walk", "m/s^2/sqrt(s)", "ug/sqrt(s)"),
        ("quantisation", "quantisation", "m/s", "m/s"),
    ),
}
"""As data sheets name them: name, field, unit inside, unit shown."""


def allan(
    paths: Annotated[list[Path], typer.Argument(metavar="LOG", help="A log of an IMU at rest, half a minute or more.")],
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the deviations: a .png or .svg.")] = None,
    settings: Settings = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Tell the noise of an IMU from its Allan deviations, in the units of data sheets, and as fuser.map reads it.

    Example: recon allan overnight.csv --plot allan.png
    """
    from recon import api
    from recon.allan import analyse
    from recon.errors import DataError
    from recon.pipeline import Pipeline
    from recon.schema import APPENDED

    _refuse_kind(plot)
    reading = Pipeline.of("allan", "reader.auto")
    registry = registry_of(blocked, first_party_only)
    log = api.execute(reading, paths, None, overrides_of(settings), registry=registry).recording
    if "imu" not in log:
        streams = ", ".join(name for name in log if name not in APPENDED) or "nothing"
        text = f"{', '.join(map(str, paths))}: there is no IMU in it, only {streams}"
        raise DataError(text, "give a log with the accelerometer and gyroscope of a box that stood still")
    found = analyse(log["imu"], log.get("gnss"))
    if plot is not None:
        _draw(plot, found)
    data = _as_data(found)
    if as_json:
        console.write_json({"paths": [str(path) for path in paths], **data})
    else:
        console.write(_as_text(", ".join(map(str, paths)), data))
        if plot is not None:
            console.write(f"plot: {plot}")


def _as_data(found: Allan) -> dict[str, Any]:
    """Every number, in the units of data sheets; null where a term does not show in a record of this length."""
    from recon.allan import fuser_params
    from recon.units import convert

    terms = []
    for axis in found.axes:
        told = {}
        for name, term, si, unit in _TERMS[axis.sensor]:
            value = getattr(axis.noise, term)
            told[name] = {"value": convert(value, si, unit) if value else None, "unit": unit}
        terms.append({"axis": f"{axis.sensor}_{axis.name}", **told})
    ratio, tau_s = found.unexplained()
    curves = {f"{axis.sensor}_{axis.name}": axis.deviation.tolist() for axis in found.axes}
    return {
        "from_s": found.start_s,
        "to_s": found.stop_s,
        "rate_hz": found.rate_hz,
        "terms": terms,
        "unexplained": {"ratio": ratio, "tau_s": tau_s},
        "fuser.map": fuser_params(found),
        "tau_s": found.tau_s.tolist(),
        "deviation_si": curves,
    }


def _as_text(name: str, data: dict[str, Any]) -> str:
    from recon.allan import SHAKEN

    span = data["to_s"] - data["from_s"]
    lines = [
        f"{name}: at rest from {data['from_s']:.1f} to {data['to_s']:.1f} s ({span:.0f} s, {data['rate_hz']:.4g} Hz)"
    ]
    for sensor, title in (("gyro", "gyroscope"), ("accel", "accelerometer")):
        some = [one for one in data["terms"] if one["axis"].startswith(sensor)]
        if not some:
            continue
        head = (title, "x", "y", "z", "")
        rows = [(term, *(_shown(one[term]["value"]) for one in some), unit) for term, _, _, unit in _TERMS[sensor]]
        lines += ["", console.table([head, *rows])]
    lines += ["", "- does not show in a record of this length: a minute tells white noise, hours tell walks"]
    unexplained = data["unexplained"]
    if unexplained["ratio"] > SHAKEN:
        shaken = f"{unexplained['ratio']:.1f} times what these terms make of them, most at {unexplained['tau_s']:.2g} s"
        lines += [f"warning: deviations are up to {shaken}: something shook the box; record it with the engine off"]
    steps = "".join(f"      {key}: {value}\n" for key, value in data["fuser.map"].items())
    lines += ["", "for a pipeline (the moving car shakes more: fuser.map starts from these and estimates it):"]
    return "\n".join([*lines, f"  - use: fuser.map\n    params:\n{steps}".rstrip()])


def _refuse_kind(plot: Path | None) -> None:
    """Raises ConfigError where the ending names no kind of picture: asked before any work is done."""
    if plot is not None and plot.suffix.lower() not in (".png", ".svg"):
        raise bad_option(f"--plot {plot} is no picture", "write NAME.png or NAME.svg")


def _shown(value: float | None) -> str:
    from recon.rounding import rounded

    return "-" if value is None else rounded(value, digits=3)


def _label(line: Any) -> None:
    """Write the numbers of a logarithmic axis out: 1, 2 and 5 of each decade where it has no more than two."""
    from matplotlib.ticker import LogLocator, NullFormatter

    low, high = line.get_view_interval()
    line.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high <= 1e2 * low else (1.0,)))
    line.set_major_formatter(lambda value, _: f"{value:g}")
    line.set_minor_formatter(NullFormatter())


def _draw(path: Path, found: Allan) -> None:
    """Deviations with what was fitted. Raises PluginError without Matplotlib, StorageError."""
    import numpy as np

    from recon.extras import needs
    from recon.storage import staged_file
    from recon.units import convert

    with needs("the plot", "matplotlib", extra="figures"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=(6.7, 3.4), layout="constrained")
    shown = {"gyro": ("rad/s", "deg/s", "Gyroscope"), "accel": ("m/s^2", "ug", "Accelerometer")}
    axes = figure.subplots(1, 2)
    for plot, (sensor, (si, unit, title)) in zip(axes, shown.items(), strict=True):
        size = convert(1.0, si, unit)
        for color, axis in zip(("#0072B2", "#D55E00", "#009E73"), found.of(sensor), strict=False):
            deviation = size * axis.deviation
            low, high = deviation * (1.0 - found.relative), deviation * (1.0 + found.relative)
            plot.fill_between(found.tau_s, np.maximum(low, 1e-12), high, color=color, alpha=0.15, linewidth=0)
            plot.loglog(found.tau_s, deviation, color=color, linewidth=1.3, label=axis.name)
            plot.loglog(
                found.tau_s, size * axis.noise.deviation(found.tau_s), color=color, linewidth=0.8, linestyle=":"
            )
        for line in (plot.xaxis, plot.yaxis):
            _label(line)
        plot.set_title(title, fontsize=9)
        plot.set_xlabel("averaged over [s]")
        plot.set_ylabel(f"Allan deviation [{unit}]")
        plot.grid(color="#e4e6e8", which="both")
        plot.legend(frameon=False, fontsize=8, title="dotted: fitted", title_fontsize=7)
    with staged_file(path) as partial:
        figure.savefig(partial, dpi=160, format=path.suffix[1:].lower())
