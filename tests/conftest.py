"""What all tests share: where the real logs are, and what a skip means."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).parent.parent

# What else runs on the machine is no fault of what is tested.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")


@pytest.fixture(scope="session")
def logs() -> Path:
    """Folder of the real logs, named by RECON_TEST_DATA."""
    folder = os.environ.get("RECON_TEST_DATA")
    if not folder:
        pytest.skip("RECON_TEST_DATA does not name the folder of the real logs")
    return Path(folder)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]):
    """With RECON_TEST_ALL=1 nothing may be skipped: a skip becomes a failure that gives the reason."""
    outcome = yield
    report = outcome.get_result()
    if report.skipped and os.environ.get("RECON_TEST_ALL") == "1" and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"skipped although RECON_TEST_ALL=1: {report.longrepr}"
