r"""Which level gives way to which, as a configuration.

Starting outside a safe set is no special case: a barrier :math:`h < 0` makes its row
:math:`\dot h \ge -\lambda h` ask for a return at the rate :math:`\lambda|h|`. Where the box allows
it that is what the command does; where it does not, the level's slack is what is lacking, as
little as the box allows, so that the command returns as fast as it can and says by how much it
falls short.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from clfcbf.errors import ConfigurationError
from clfcbf.qp.backends import Backend
from clfcbf.qp.ladder import solve_ladder
from clfcbf.qp.lexicographic import Box, Level, LexicographicSolution, Weight

__all__ = ["Ladder", "LadderSolution"]


class LadderSolution(NamedTuple):
    """Answer of :meth:`Ladder.solve`.

    Attributes
    ----------
    v, omega : the command [m/s], [rad/s], inside the box
    slacks : by how much the rows of each priority had to move [units of the command]
    unmet : priorities of rigid levels that no command satisfies; the command then is the one of
        least violation and not one to send
    answer : the lexicographic solution behind it
    """

    v: float
    omega: float
    slacks: dict[int, float]
    unmet: tuple[int, ...]
    answer: LexicographicSolution

    @property
    def admissible(self) -> bool:
        """Whether every rigid level holds."""
        return not self.unmet


@dataclass(frozen=True, slots=True)
class Ladder:
    """Which rows give way to which, as a configuration.

    The box, that is the limits, never gives way. Below it rows are grouped by priority; a group
    has one slack on its rows of unit length, and is relaxed, by the least amount, only after all
    groups before it are fixed [Kerrigan2002]_. The nominal command comes last.

    Attributes
    ----------
    order : priorities, the most important first; empty for ascending order, as of
        :class:`clfcbf.constraints.rows.Priority`
    rigid : priorities whose rows must hold as they are: where they cannot, the answer says so
        instead of standing for one. They come before all others
    backend : takes the last step

    Raises
    ------
    ConfigurationError : a priority is listed twice, or a rigid one comes after one that is not
    """

    order: tuple[int, ...] = ()
    rigid: frozenset[int] = frozenset()
    backend: str | Backend = "exact"

    def __post_init__(self) -> None:
        if len(set(self.order)) < len(self.order):
            raise ConfigurationError(f"order must not repeat a priority, got {self.order!r}")
        if self.order and not self.rigid <= set(self.order):
            missing = sorted(self.rigid - set(self.order))
            raise ConfigurationError(f"rigid priorities {missing} are not in order {self.order!r}")
        if set(self.order[: len(self.rigid)]) - self.rigid and self.rigid:
            raise ConfigurationError(
                f"rigid priorities must come first, got order {self.order!r} "
                f"and rigid {sorted(self.rigid)}"
            )

    def solve(
        self,
        weight: Weight,
        nominal: tuple[float, float],
        box: Box,
        rows: Mapping[int, Level],
    ) -> LadderSolution | None:
        """The command nearest to ``nominal`` that gives up as little as it must, in order.

        Parameters
        ----------
        weight, nominal, box : as of :func:`solve_ladder`
        rows : rows ``(a_v, a_w, b)`` by priority

        Returns
        -------
        The solution, or None where the data is not finite

        Raises
        ------
        ConfigurationError : a priority of ``rows`` is not in ``order``, or a rigid one comes
            after one that is not
        """
        unknown = sorted(set(rows) - set(self.order)) if self.order else []
        if unknown:
            raise ConfigurationError(f"priorities {unknown} are not in order {self.order!r}")
        order = [p for p in self.order or sorted(rows) if p in rows]
        firm = [p in self.rigid for p in order]
        if firm != sorted(firm, reverse=True):
            raise ConfigurationError(
                f"rigid priorities must come first, got order {order} and rigid "
                f"{sorted(self.rigid)}"
            )
        answer = solve_ladder(weight, nominal, box, [rows[p] for p in order], self.backend)
        if answer is None:
            return None
        unmet = [p for p, slack in zip(order, answer.slacks, strict=True) if slack > 0.0]
        index = 0
        for priority in order:
            if any(index <= k < index + len(rows[priority]) for k in answer.violated):
                unmet.append(priority)
            index += len(rows[priority])
        return LadderSolution(
            answer.v,
            answer.omega,
            dict(zip(order, answer.slacks, strict=True)),
            tuple(p for p in order if p in unmet and p in self.rigid),
            answer,
        )
