"""Batches: one pipeline over the drives of a fleet, each drive once, nothing lost.

    places       files and folders, local or in an object store
    inputs       what a batch file names -> drives
    drive_job    one drive through the pipeline: the picklable unit of work
    root         the folder of all results: how a result becomes whole, what is there
    lock         one batch at a time on one root
    flight       one pass of an executor over drives
    driver       drives -> jobs -> executor -> outcomes; what need not be done again
    compacted    jobs.parquet, events.parquet, metrics.parquet as they are: what need not be read again
    compaction   all results -> jobs.parquet, events.parquet, metrics.parquet
    summary      these files -> what the owner of a fleet wants to know

A result is ROOT/vehicle=<vehicle>/drive=<drive>/, and it counts when its manifest.json is there: it is made in
ROOT/.scratch and renamed as a whole; in an object store, which renames nothing, the manifest is written last.
ROOT/.scratch belongs to the batch that holds the lock and is emptied by the next one.
"""

from __future__ import annotations
