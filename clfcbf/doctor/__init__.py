"""What is installed, whether it works, and how fast: packages, backends, one timing each.

Run as ``clfcbf doctor``, or ``print(table(examine()))``.
"""

from clfcbf.doctor.examination import Examination, examine
from clfcbf.doctor.packages import Package, check_packages, licence_of
from clfcbf.doctor.probe import Probe, probe
from clfcbf.doctor.table import table

__all__ = [
    "Examination",
    "Package",
    "Probe",
    "check_packages",
    "examine",
    "licence_of",
    "probe",
    "table",
]
