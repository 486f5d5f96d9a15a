"""What other Python threads do to a control loop, see docs/realtime.md: jitter.py [SECONDS]."""

import gc
import sys
import threading

from clfcbf import Decision, Limits, Observation, Status, Twist
from clfcbf.runtime import ControlLoop, LoopPolicy, LoopStatistics, Overrun

REST = Twist(0.0, 0.0)


class Still:
    """Controller, chassis and sensor of a robot that stands."""

    def step(self, observation: Observation | None, applied: Twist, now: float) -> Decision:
        """Stand."""
        return Decision(REST, Status.STOPPED, True, REST, 0.0)

    def applied(self) -> Twist:
        """Zero."""
        return REST

    def idle(self, *_: Twist) -> None:
        """See nothing and take any command."""

    observe = send = stop = idle


def measure(seconds: float) -> LoopStatistics:
    """Statistics of ticks at 100 Hz."""
    robot, limits = Still(), Limits(0.22, 0.4, 0.3, 1.0)
    policy = LoopPolicy(Overrun.SEND, misses=10**9)
    loop = ControlLoop(robot, robot, robot, period=0.01, limits=limits, policy=policy)
    return loop.run(seconds).statistics


def main(seconds: float = 5.0) -> dict[str, LoopStatistics]:
    """Print how long after they were due ticks began: alone, and beside a thread that computes."""
    found, usual, over = {"alone": measure(seconds)}, sys.getswitchinterval(), threading.Event()
    thread = threading.Thread(target=lambda: [sum(range(1000)) for _ in iter(over.is_set, True)])
    thread.start()
    try:
        for interval in (usual, 5e-4, 5e-5):
            sys.setswitchinterval(interval)
            found[f"busy thread, {1e3 * interval:g} ms"] = measure(seconds)
    finally:
        sys.setswitchinterval(usual)
        over.set()
        thread.join()
    for name, statistics in found.items():
        p50, _, p99, worst = (1e3 * late for late in statistics.lateness)
        print(f"{name:22} p50 {p50:6.2f}, p99 {p99:6.2f}, worst {worst:6.2f} ms late")
    return found


if __name__ == "__main__":
    gc.freeze()  # the collector never looks again at what exists now
    main(*map(float, sys.argv[1:]))
