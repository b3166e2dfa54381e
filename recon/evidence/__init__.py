"""Evidence: a finished run as one file that anybody can check and run again.

    sealed = seal("drive-crash", "drive.zip")      the raw log, pipeline, manifest, versions and results, hashed
    verify("drive.zip", sha256=sealed.sha256)      every byte as it was; run again, the same numbers

The file is a zip archive of stored (not compressed) entries in one order and with one date, so that equal runs give
equal bytes and every byte of it can be told from its contents:

    README.txt             what it is, and how to check it with and without recon
    SHA256SUMS             of every other file, as `sha256sum -c` reads it
    inputs/<n>/<name>      the log, as it was read
    manifest.json          what made the result: steps, parameters, versions, hashes; no path, host or time of day
    pipeline.yaml          the pipeline that was run
    results/...            the streams that came out
    exports/...            files for people, where they were asked for; made again where their exporter repeats
    versions.json          code and packages that gave the same bytes again when the file was sealed

A hash inside of a file cannot vouch for that file: who changes both leaves no trace but in what a replay finds, and a
log that was exchanged before it was sealed is beyond any program. So the SHA-256 of the archive is to be noted where
others can see it, in the report or with a time stamp authority (RFC 3161), when it is sealed.

References
    FIPS 180-4 (SHA-256); PKWARE, APPNOTE.TXT 6.3.10; ISO/IEC 27037:2012, 7.1.4 (preservation of digital evidence).
"""

from __future__ import annotations

from recon.evidence.contents import is_seal
from recon.evidence.sealing import Sealed, seal
from recon.evidence.verification import Verified, unsealed, verify

__all__ = ["Sealed", "Verified", "is_seal", "seal", "unsealed", "verify"]
