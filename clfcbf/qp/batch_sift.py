"""Which programs of a batch are more than a box: most ticks hold every row as it is.

A pass without copies over the arguments as they were given. What it cannot settle, invalid data
included, goes on to the solve proper, gathered to chunks of a useful size.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clfcbf.qp.batch_chunks import TAME, Chunk, Programs, slices
from clfcbf.qp.batch_geometry import NOISE, Array, Index, Mask, reach_of

__all__ = ["unsettled"]

_KEPT = 2 * 2**20
"""Numbers in a block that is asked for and given back untouched. Once it has seen one, glibc's
allocator keeps as much freed memory for what comes next; otherwise it returns it to the system
between chunks and fetches it page by page, a third of the whole time (measured)."""

_WORTH_A_LOOK = 4096
"""Fewer programs are solved as fast as they are looked through (measured)."""


def unsettled(programs: Programs, size: int, twist: Array) -> Iterator[Chunk]:
    """Write the commands at which every row holds with room for rounding; yield the rest.

    Parameters
    ----------
    programs : of the batch
    size : programs looked at at a time, and least number in a chunk but the last
    twist : for the commands, shape (B, 2)

    Returns
    -------
    Iterator over the programs left, each chunk to be used before the next one is asked for;
    their commands in ``twist`` are undefined
    """
    np.empty(_KEPT)
    count = programs.sizes[0]
    places = list(slices(count, size))
    columns = np.empty((programs.numbers, min(2 * size, count)))
    origin = np.empty(columns.shape[1], dtype=np.intp)
    # With a weight in both inputs the minimum in the box is not that of each input.
    apart = programs.weight.ndim == 1 and programs.weight[1] == 0.0 and count >= _WORTH_A_LOOK
    filled = 0
    for place in places:
        everyone = np.arange(place.stop - place.start)
        left = _left(programs, place, twist[place]) if apart else everyone
        end = filled + left.size
        programs.gather(place, left, columns[:, filled:end])
        np.add(left, place.start, out=origin[filled:end])
        filled = end
        if filled >= size or (filled and place.stop == count):
            yield programs.chunk(origin[:filled], columns[:, :filled])
            filled = 0


@np.errstate(all="ignore")  # data that is not finite, or overflows, is left
def _left(programs: Programs, place: slice, twist: Array) -> Index:
    """Where the nominal commands, moved into the boxes, may not be the answers."""
    nominal, box = programs.nominal[place], programs.box[place]
    levels = programs.hard[place], programs.soft[place]
    reach = reach_of(_common(box))
    lengths = [reach_of(_common(rows)) for rows in levels]
    if not all(number <= TAME for number in (reach, reach_of(nominal), *lengths)):
        return np.arange(len(nominal))
    np.maximum(nominal, box[:, 0::2], out=twist)
    np.minimum(twist, box[:, 1::2], out=twist)
    left: Mask = box[:, 0] > box[:, 1]
    left |= box[:, 2] > box[:, 3]
    v, w = twist[:, 0], twist[:, 1]
    for rows, length in zip(levels, lengths, strict=True):
        # Wider than the margin of any of these rows, so that none is settled on its line.
        margin = 12.0 * NOISE * reach * length
        for a, c, b in rows.transpose(1, 2, 0):
            over = a * v
            over += c * w
            over -= b
            left |= over > -margin
    return np.flatnonzero(left)


def _common(array: Array) -> Array:
    """One copy where all programs share their numbers."""
    return array[:1] if array.strides[0] == 0 else array
