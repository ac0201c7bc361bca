"""Recordings that cannot show a gap: with no observations to spare, or with axes turned by gyro or references, nobody knows."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from diagnosis.assemble import explain_blindness
from diagnosis.diagnose import diagnose
from diagnosis.settings import DEFAULT
from studies.report.diagnosis import format_headline
from tests.diagnosis.recordings import QUICK, slews


def turned(recording, offset_deg):
    """The recording with a constant rotation E of its references, A_obs = E A."""
    q = Rotation.from_quat(recording.attitudes.quaternions) * Rotation.from_rotvec(np.deg2rad(offset_deg))
    return replace(recording, attitudes=replace(recording.attitudes, quaternions=q.as_quat()))


def test_a_large_offset_of_the_references_is_not_identifiable():
    found = diagnose(turned(slews(seed=4), [0.0, 3.0, 0.0]), settings=QUICK)
    assert (found.verdict, found.present, found.causes) == ("not identifiable", False, ())
    assert "3 deg" in found.notes[0]
    assert "constant offset of the references" in found.notes[0]
    assert format_headline(found) == "This recording cannot show whether there is a misfit"


def explain(G, sigma=1e-4, apriori=None, plausible=0.01, dof=6):
    return explain_blindness(dof, G, np.full((3, 3), sigma), np.eye(3) if apriori is None else apriori, plausible, DEFAULT)


def test_a_rotation_beyond_its_error_or_no_spare_observation_makes_blind():
    G = Rotation.from_rotvec([0.0, 0.0, 0.05]).as_matrix() @ np.diag([1.02, 0.98, 1.0])
    assert "about x, y, z" in str(explain(G))
    assert explain(np.diag([1.1, 0.9, 1.0])) is None  # scale factors turn nothing
    assert explain(G, sigma=0.02) is None  # within its own error
    assert explain(G, apriori=G) is None
    assert explain(G, plausible=0.1) is None  # as gyros of a coarse grade are mounted
    assert "as many parameters" in str(explain(np.eye(3), dof=0))
