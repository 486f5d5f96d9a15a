"""The time-optimal floor under every docking time: same limits, same view, nothing unknown."""

from benchmarks.floor.certificate import Certificate, certify, least_time
from benchmarks.floor.program import Motion
from benchmarks.floor.search import Floor, floor_time

__all__ = ["Certificate", "Floor", "Motion", "certify", "floor_time", "least_time"]
