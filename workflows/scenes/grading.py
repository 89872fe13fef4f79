"""Where the elements of a box of blocks are finer than a block: beside clamps, and beside the sides that meet them.

At a clamp, and most where it ends at a free side, stress varies within a block; elements of one block answer for that
with an error that reaches the blocks behind. So the two outer rows of blocks are halved there.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from tsg_micro.data.voxels import SIDES
from workflows.scenes.model import SceneModel

__all__ = ["graded_by_default", "halved_sides", "halved_sides_of"]


def graded_by_default(blocks: Sequence[int], *, degree: int, element: str | None) -> bool:
    """Whether a box of ``blocks`` (3,) has its outer ones halved where nothing is said: in sheets that can bend."""
    return blocks[2] == 1 and degree == 1 and element != "trilinear"


def halved_sides(blocks: Sequence[int], held: Collection[str], touched: Collection[str]) -> tuple[str, ...]:
    """Sides of a box of ``blocks`` (3,) at which its outer blocks are halved.

    They are the ``held`` ones, and those that meet one of these and are without support, not ``touched``; none across
    which the box is one block thick.
    """
    axes = {SIDES.index(side) // 2 for side in held}
    return tuple(
        side
        for number, side in enumerate(SIDES)
        if blocks[number // 2] > 1 and (side in held or (side not in touched and axes - {number // 2}))
    )


def halved_sides_of(scene: SceneModel, blocks: Sequence[int]) -> tuple[str, ...]:
    """Those of the scene's body, a box of ``blocks`` (3,); by default in sheets of the default element."""
    solve, wanted = scene.solve, scene.body.graded
    if not (graded_by_default(blocks, degree=solve.degree, element=solve.element) if wanted is None else wanted):
        return ()
    held, touched = (set(SIDES) & sides for sides in (scene.held, scene.supported))
    return halved_sides(blocks, held, touched)
