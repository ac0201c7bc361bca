"""Sets of sensor effects.

Sensors are mounted and calibrated one by one, and several of them may be off at a time: R's were four effects, both sensors'
heads, the misalignment and the Earth sensor's biases. Sets are therefore larger than those of the gyro's effects. The evidence
of a set is that of `diagnosis.inference.search.Search`; what differs is how sets are found: a beam over the listed effects,
and then the rivals, alone and beside the best of the listed sets.
"""

from __future__ import annotations

from diagnosis.inference.search import Explanation, Member, Search

LARGEST_SET = 5
BEAM = 6
BESIDE = 4  # listed sets that rivals are tried beside
HOPELESS = 12.0  # log posterior below the best at which a larger set's parents are no longer followed


class SensorSearch(Search):
    """Search over sets of the sensors' effects."""

    def explanations(self, depth: int = LARGEST_SET) -> list[Explanation]:
        """Sets of up to `depth` effects worth a thought, the best first."""
        candidates = self.bank.candidates
        listed = [k for k, candidate in enumerate(candidates) if candidate.listed]
        rivals = [k for k, candidate in enumerate(candidates) if not candidate.listed]
        found = {one.key: one for one in self.singles()}
        level = _best([one for key, one in found.items() if key <= set(listed)])
        for _ in range(depth - 1):
            new = {}
            for parent in level[:BEAM]:
                for k in listed:
                    key = parent.key | {k}
                    if k not in parent.key and key not in found and key not in new:
                        new[key] = self._more(parent, k)
            found |= new
            level = _best(list(new.values()))
            top = _best(list(found.values()))[0].log_posterior
            if not level or level[0].log_posterior < top - HOPELESS:
                break
        for _ in range(2):  # one rival, then another beside it
            for parent in _best(list(found.values()))[:BESIDE]:
                if len(parent.key) < depth + 1:
                    for k in rivals:
                        if k not in parent.key and parent.key | {k} not in found:
                            found[parent.key | {k}] = self._more(parent, k)
        return _best(list(found.values()))

    def of(self, chosen: tuple[str, ...]) -> Explanation | None:
        """The explanation by given labels, whatever its evidence; None if one cannot be seen at all."""
        places = [self.bank.find(label) for label in chosen]
        if not places or any(place is None for place in places):
            return None
        return self.settled(tuple(Member(place, 0, 0) for place in places if place is not None))

    def _more(self, parent: Explanation, candidate: int) -> Explanation:
        """A set with one more effect, its members moved to their best."""
        score = self.score(candidate, self.given(parent.members))
        return self.settled((*parent.members, Member(candidate, score.option, score.scale)))


def _best(explanations: list[Explanation]) -> list[Explanation]:
    return sorted(explanations, key=lambda one: -one.log_posterior)
