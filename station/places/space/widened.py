"""A map's space, wider by what a rig in somebody's hands saw later from where its images say that it is.

The mapping navigation need not have looked everywhere: in a hall one may stand where no camera looked, and be
recognised by what is around. What an image looks through from there is free as what the mapping cameras looked through,
and known by the same rule: as far as one gets from what was known without squeezing. Who looks back through a door from
a room without a map is beyond it still, unless the door is at hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shared.geometry import FloatArray
from station.places.space.carving import FARTHEST_M, SEEN_BY, Carving
from station.places.space.sight import Sight
from station.places.space.space import CARRIED_AT_HAND_M, Cells, Space, closed, reached_from, within


@dataclass(frozen=True, slots=True, eq=False)
class WidenedSpace:
    space: Space
    known: Cells  # of the grid of `space`: by the map, or since

    @classmethod
    def of(cls, space: Space) -> WidenedSpace:
        """Nothing was seen since."""
        return cls(space, space.known)

    def knows(self, p_map: FloatArray) -> Cells:
        """(n,) whether positions (n, 3) lie where the map knows its way, or somebody found it since."""
        return self.space.among(self.known, p_map)

    def looking(self, eye_map: FloatArray, p_map: FloatArray) -> WidenedSpace:
        """With what an image saw through that recognised points (n, 3) from an eye (3,), if it stands at hand of that.

        Each image for itself: poses err by a cell or two, and what several saw together makes a door wider.
        """
        space = self.space
        sight = Sight.of(eye_map, p_map, space.R_ground_map, FARTHEST_M * space.metre)
        if sight is None:
            return self
        eye = np.floor((sight.eye - space.low) / space.cell).astype(int)
        if not np.all((eye >= 0) & (eye < self.known.shape)):
            return self
        carving = Carving(space.low, space.cell, np.zeros_like(space.seen))
        carving.add(sight)
        half_passage = 0.5 * space.passage / space.cell
        margin = int(sight.reach.max() / space.cell + 2 * half_passage) + 2
        begin = np.maximum(eye - margin, 0)
        window = slice(begin[0], eye[0] + margin), slice(begin[1], eye[1] + margin)
        before, sees = self.known[window], carving.seen[window] > 0
        opened = reached_from(before, before | sees, half_passage) & ~before
        at_eye = np.zeros_like(before)
        at_eye[tuple(eye - begin)] = True
        at_hand = within(at_eye, CARRIED_AT_HAND_M * space.metre / space.cell)
        if not np.any(opened & at_hand):
            return self
        behind = at_hand & ~sees & (space.seen[window] < SEEN_BY)
        known = self.known.copy()
        known[window] = closed(before | opened | behind, half_passage)
        return replace(self, known=known)
