r"""The brake that the loop keeps at hand, whatever becomes of controller, sensor or clock.

It mirrors the guard's: from a command :math:`u` admitted with
:math:`N = \lceil\max(|v|/(a_{max}T), |\omega|/(\alpha_{max}T))\rceil` ticks it is
:math:`u(1 - k/N)`, :math:`k = 1 \dots N`, along the same circle. Where the controller has sent
the brake's next command itself, the ticks are counted down and never computed again, as the
guard counts them; so a brake that the guard has verified is followed to its end as verified.
"""

from __future__ import annotations

from clfcbf.guard import ROUNDING, Brake
from clfcbf.limits import Limits
from clfcbf.se2 import Twist, is_finite

__all__ = ["Braking"]

_REST = Twist(0.0, 0.0)


class Braking:
    """The next command of the same-curvature brake, from whatever was accepted last.

    Parameters
    ----------
    limits, period : of the chassis, as the guard has them

    Attributes
    ----------
    sent : the command last passed to the chassis
    """

    __slots__ = ("_brake", "_limits", "_period", "sent")

    def __init__(self, limits: Limits, period: float) -> None:
        self._limits = limits
        self._period = period
        self._brake = Brake(_REST, 0)
        self.sent = _REST

    def accepted(self, twist: Twist) -> None:
        """``twist`` was sent: the brake starts from it, or goes on where it was its own."""
        following = self._brake.next()
        self._brake = following if _same(twist, following.twist) else self._from(twist)
        self.sent = twist

    def command(self, applied: Twist) -> Twist:
        """The next command to rest, inside the input box around ``applied``.

        Where another command is in force than the one sent (a base that has stopped by itself,
        or rounds), the brake starts from that: it never speeds up to where it should be.
        """
        brake = self._brake if _same(applied, self.sent) else self._from(applied)
        twist = brake.next().twist
        box = self._limits.input_box(applied, self._period)
        # Clipped by rounding alone, the last command would be 1e-17 and not zero.
        return twist if box.contains(twist, ROUNDING) else box.clip(twist)

    def known(self, applied: Twist) -> Twist:
        """The command in force, as reported; the one last sent where that is no finite twist."""
        try:
            twist = Twist(*applied)
            return twist if is_finite(twist) else self.sent
        except (TypeError, ValueError):
            return self.sent

    def ticks(self, applied: Twist) -> int:
        """Ticks to rest from ``applied``."""
        return max(self._brake.ticks, self._limits.brake_ticks(applied, self._period))

    def _from(self, twist: Twist) -> Brake:
        return Brake(twist, self._limits.brake_ticks(twist, self._period))


def _same(one: Twist, other: Twist) -> bool:
    return abs(one[0] - other[0]) <= ROUNDING and abs(one[1] - other[1]) <= ROUNDING
