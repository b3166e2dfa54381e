"""Are a followed log's accelerations and turn rates in the units that its reader takes them for?

analyzer.doctor is asked about the beginning of the log each time that it has become half as long again. What it says
twice running is believed: a few seconds of a drive have deceived it before.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Final

import pyarrow as pa

from recon.api import execute
from recon.errors import ReconError
from recon.findings import STAGE, findings_in
from recon.pipeline import Pipeline
from recon.plan import PlannedStep
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import Metric, metrics
from recon.tables import append, time_ns

_CODES: Final = ("accel_unit", "gyro_unit")
_FIRST_S, _LAST_S, _GROWS = 10.0, 600.0, 1.5
"""s of the log at which it is looked at first and last, and the factor between."""
_TAKEN: Final = ("imu", "gnss")


class Units:
    """Give it the rows of imu and gnss as they come; `doubts` are the sentences on what cannot be right.

    reader : whose units are doubted
    """

    def __init__(self, reader: PlannedStep, registry: Registry) -> None:
        self.doubts: list[str] = []
        self._registry = registry
        told = json.dumps(reader.params.as_si(), sort_keys=True)
        self._taken_for = metrics([Metric("reader_parameters", method=reader.stage.key, note=told)])
        self._rows: dict[str, list[pa.Table]] = {name: [] for name in _TAKEN}
        self._begun_ns, self._look_at_s = 0, _FIRST_S
        self._before: dict[str, str] = {}
        self._open = set(_CODES)

    def take(self, rows: Mapping[str, pa.Table], learnt: pa.Table | None) -> None:
        """Rows that follow those given before. learnt : metrics of the reader, which tell what it took for granted"""
        if not self._open:
            return
        for name, before in self._rows.items():
            if name in rows and rows[name].num_rows:
                before.append(rows[name].cast(before[0].schema) if before else rows[name])
        imu = self._rows["imu"]
        if not imu:
            return
        self._begun_ns = self._begun_ns or int(time_ns(imu[0])[0])
        length_s = (int(time_ns(imu[-1])[-1]) - self._begun_ns) * 1e-9
        if length_s >= self._look_at_s:
            self._look_at_s = _GROWS * length_s
            self._look(learnt)
        if length_s >= _LAST_S or not self._open:
            self._open = set()
            self._rows = {name: [] for name in _TAKEN}

    def _look(self, learnt: pa.Table | None) -> None:
        """Whatever keeps the doctor from saying anything ends no drive."""
        streams = {name: pa.concat_tables(parts) for name, parts in self._rows.items() if parts}
        streams["metrics"] = append(learnt, self._taken_for)
        try:
            asked = execute(Pipeline.of("units", STAGE), Recording(streams), None, (), registry=self._registry)
        except ReconError:
            return
        for one in findings_in(asked.metrics):
            code, said = one["code"], one["status"]
            if code in self._open and said != "unknown" and said == self._before.get(code):
                self._open.remove(code)
                if said == "contradicted":
                    self.doubts.append(f"{code}: {one['explanation']} 'recon doctor' says what puts it right")
            self._before[code] = said
