"""Connected components of a stencil, by union and find.

Serial, as a pixel's label comes from its neighbours above and to the left. Bands of rows could be
labelled apart and joined at their seams, but forty objects in a 1080p stencil take 1.7 ms.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels.jit import inlined, part, serial

I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]


SPAN = 64
"""Pixels of a row that are looked at together."""


@inlined
def same(stencil: I32, ident: np.int32, i: int, j: int) -> bool:
    """Whether pixel (i, j) exists and has this id."""
    return i >= 0 and 0 <= j < stencil.shape[1] and stencil[i, j] == ident


@inlined
def root_of(parent: I32, label: int) -> int:
    """Return the first label of a set; on the way there, every other label skips one."""
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = int(parent[label])
    return label


@inlined
def join(parent: I32, one: int, other: int) -> int:
    """Make one set of two, under the lower root, and return that."""
    one, other = root_of(parent, one), root_of(parent, other)
    low, high = min(one, other), max(one, other)
    parent[high] = low
    return low


@part
def look_at(row: I32, before: I32) -> tuple[bool, bool]:
    """Return whether a span shows objects, and whether the one above it has other ids."""
    most, changed = np.int32(0), np.int32(0)
    for j in range(row.size):
        most = max(most, row[j])
        changed |= row[j] ^ before[j]
    return bool(most > 0), bool(changed != 0)


@part
def fill_span(here: I32, label: np.int32) -> None:
    """Write one label."""
    for j in range(here.size):
        here[j] = label


@part
def settle_span(parent: I32, here: I32) -> None:
    """Replace provisional labels by those of their sets; most spans have one."""
    several = np.int32(0)
    for j in range(here.size):
        several |= here[j] ^ here[0]
    if several == 0:
        fill_span(here, parent[here[0]])
        return
    for j in range(here.size):
        here[j] = parent[here[j]]


@part
def copy_span(above: I32, here: I32) -> None:
    """Copy labels."""
    for j in range(here.size):
        here[j] = above[j]


@inlined
def label_span(
    stencil: I32,
    i: int,
    columns: tuple[int, int],
    above: I32,
    here: I32,
    parent: I32,
    count: int,
) -> int:
    """Label some columns of row i pixel by pixel; see `label_row`."""
    for j in range(columns[0], columns[1]):
        ident = stencil[i, j]
        if ident <= 0:
            here[j] = 0
            continue
        if same(stencil, ident, i - 1, j):
            # It touches the other three, so they are of its set already.
            here[j] = above[j]
            continue
        label = 0
        if same(stencil, ident, i, j - 1):
            label = int(here[j - 1])
        elif same(stencil, ident, i - 1, j - 1):
            label = int(above[j - 1])
        if same(stencil, ident, i - 1, j + 1):
            right = int(above[j + 1])
            label = right if label == 0 else join(parent, label, right)
        if label == 0:
            count += 1
            label = count
            parent[label] = label
        here[j] = label
    return count


@inlined
def label_row(stencil: I32, i: int, above: I32, here: I32, parent: I32, count: int) -> int:
    """Label row i by what is above and to the left, note which labels meet; return how many.

    `above` and `here` are the labels of the row before, and of this one, which are written; `count`
    is how many labels were given before. Most spans are empty, or those of the row above and so
    labelled: asking for that first halves the time for a block.
    """
    row, before = stencil[i], stencil[max(i - 1, 0)]
    for begin in range(0, row.size, SPAN):
        end = min(begin + SPAN, row.size)
        shown, changed = look_at(row[begin:end], before[begin:end])
        if not shown:
            fill_span(here[begin:end], np.int32(0))
        elif i > 0 and not changed:
            copy_span(above[begin:end], here[begin:end])
        else:
            count = label_span(stencil, i, (begin, end), above, here, parent, count)
    return count


@serial
def label(stencil: I32, labels: I32) -> int:
    """Label the connected pixels of equal id.

    Parameters
    ----------
    stencil
        int32 [H, W], ids. 0 and below is background: static, or mixed.
    labels
        int32 [H, W], written: 0 background, else 1 and up, in the order in which the components'
        first pixels come, row by row.

    Returns
    -------
    int
        How many components there are.

    Notes
    -----
    A pixel's eight neighbours touch it. The root of a set is its lowest label, which was given to
    its first pixel; so roots ascend in the order that is wanted.
    """
    parent = np.empty(stencil.size + 1, np.int32)
    parent[0] = 0
    given, count = 0, 0
    for i in range(labels.shape[0]):
        given = label_row(stencil, i, labels[max(i - 1, 0)], labels[i], parent, given)
    for k in range(1, given + 1):
        if parent[k] == k:
            count += 1
            parent[k] = count
        else:  # its parent is lower, so that one's number is final
            parent[k] = parent[parent[k]]
    if count == given:  # none met
        return count
    for i in range(labels.shape[0]):
        for begin in range(0, labels.shape[1], SPAN):
            settle_span(parent, labels[i, begin : begin + SPAN])
    return count


@inlined
def add_runs(labels: I32, areas: I64) -> None:
    """Add the pixels of a row's labels [W]: run by run, as adding each waits for the one before."""
    begin = 0
    for j in range(1, labels.size + 1):
        if j == labels.size or labels[j] != labels[begin]:
            areas[labels[begin]] += j - begin
            begin = j


@serial
def measure_areas(stencil: I32, areas: I64) -> int:
    """Count the pixels of each component; of labels two rows are kept.

    Parameters
    ----------
    stencil
        As of `label`.
    areas
        int64 [H W + 1], its beginning is written: by label, as `label` gives them, with the
        background first.

    Returns
    -------
    int
        How many labels there are, background included.
    """
    parent = np.empty(stencil.size + 1, np.int32)
    parent[0], areas[0] = 0, 0
    rows = np.empty((2, stencil.shape[1]), np.int32)
    given = 0
    for i in range(stencil.shape[0]):
        known = given
        given = label_row(stencil, i, rows[(i + 1) % 2], rows[i % 2], parent, given)
        for k in range(known + 1, given + 1):
            areas[k] = 0
        add_runs(rows[i % 2], areas)
    for k in range(given, 0, -1):
        if parent[k] != k:  # it is lower, and comes later
            areas[parent[k]] += areas[k]
    count = 0
    for k in range(1, given + 1):
        if parent[k] == k:
            count += 1
            areas[count] = areas[k]
    return count + 1
