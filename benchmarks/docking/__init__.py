"""Who docks best: every method from the same starts, with the same bodies and sensors.

``python -m benchmarks.docking`` runs a campaign, ``python -m benchmarks.docking report`` makes
tables and figures of it.
"""
