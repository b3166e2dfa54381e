"""A pipeline over a log that is still being written: sources, the session, the file that grows."""
