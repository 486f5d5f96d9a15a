"""The adversary: ``python -m benchmarks.falsify`` searches for a run in which the guarantee fails.

``assumptions`` says what it may do, ``attack`` what it decides, ``strategies`` and ``evolution``
how; ``duel`` is one run against the filter, ``paper`` the same for the paper's barrier,
``campaign`` many of them, ``report`` and ``figure`` what is left to read.
"""
