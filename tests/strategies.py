"""Hypothesis strategies shared by the tests."""

import math

from hypothesis import strategies as st

from clfcbf.limits import Limits
from clfcbf.se2 import Pose2, Twist

angles = st.floats(-math.pi, math.pi, exclude_min=True)
lengths = st.floats(-5.0, 5.0)
poses = st.builds(Pose2, lengths, lengths, angles)
points = st.tuples(lengths, lengths)
twists = st.builds(Twist, st.floats(-0.6, 0.6), st.floats(-1.5, 1.5))
limits = st.builds(
    Limits,
    v_max=st.floats(0.05, 1.0),
    omega_max=st.floats(0.05, 2.0),
    a_max=st.floats(0.05, 3.0),
    alpha_max=st.floats(0.05, 6.0),
    v_min=st.one_of(st.none(), st.floats(-1.0, 0.0)),
)
periods = st.floats(0.005, 0.2)
any_float = st.floats(allow_nan=True, allow_infinity=True)
