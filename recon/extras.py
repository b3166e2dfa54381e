"""Packages that only some users need: where one is missing, one sentence says which, and how it is installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from recon.errors import PluginError

_OURS = "recon"


def missing(who: str, package: str, extra: str) -> PluginError:
    """The error to raise. who : a stage or command; package : its name; extra : of this distribution, that brings it"""
    return PluginError(f"{who} needs {package}", f'pip install "recon-dynamics[{extra}]"')


@contextmanager
def needs(who: str, package: str, extra: str) -> Iterator[None]:
    """Around an import: a module that is not installed, there or in what it imports, raises `missing`.

    with needs("exporter.hdf5", "h5py", extra="hdf5"):
        import h5py
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").startswith(_OURS):
            raise
        raise missing(who, package, extra) from error
