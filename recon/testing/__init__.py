"""The contract suite: what every stage must keep, as plain named functions, for authors of plugins.

from recon.testing import Case, contract

@contract("filter.butter")
def test_contract(law):
    law()
"""

from __future__ import annotations

from recon.testing.contract import BoundLaw, Contract, Law, contract, laws_of
from recon.testing.subject import Case, Subject

__all__ = ["BoundLaw", "Case", "Contract", "Law", "Subject", "contract", "laws_of"]
