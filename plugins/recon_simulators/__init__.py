"""First-party simulators: recordings made from motions whose truth is known."""
