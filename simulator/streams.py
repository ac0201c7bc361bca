"""Named random streams: what a case draws depends on the study's entropy, the case and the stream's name, nothing else.

A stream is the child ``(case, *name)`` of ``SeedSequence(entropy)``. Children do not depend on the order in which they are
asked for nor on which others exist, so a case is the same alone, in parallel or resumed, and a new stream leaves every
other as it was. Entropies are hashed, not added to: neighbouring ones share nothing.
"""

import numpy as np

MAX_CASE = 2**32  # a larger number takes two words of the spawn key, and could meet another case's name there
WORD = 2**32 - 1


def generator(entropy: int, case: int, name: str) -> np.random.Generator:
    """Build the random generator of one named stream of one case; a `ValueError` for a negative entropy or a case out of range.

    Parameters
    ----------
    entropy : seed of the study, a non-negative integer
    case : number of the case, 0 ≤ case < 2³²
    name : what the stream is used for, e.g. "gyro_noise"
    """
    if not 0 <= case < MAX_CASE:
        raise ValueError(f"case must be in [0, 2**32), not {case}")
    if entropy < 0:
        raise ValueError(f"entropy must not be negative, not {entropy}")
    # SeedSequence puts the spawn key behind the entropy, of four words at least. Given as one array, it need not convert number
    # by number, which takes longer than all the rest.
    words = [int(entropy) >> low & WORD for low in range(0, max(4 * 32, int(entropy).bit_length()), 32)]
    sequence = np.random.SeedSequence(np.array([*words, case, *name.encode()], dtype=np.uint32))
    return np.random.Generator(np.random.SFC64(sequence))
