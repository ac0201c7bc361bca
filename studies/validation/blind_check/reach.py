"""What the true model reaches on held-out data: the bar for a diagnosis' closure."""

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.closure import of_response
from diagnosis.model.candidates import linear_model
from diagnosis.model.recording import RecordingModel

Array = NDArray[np.float64]


def true_closed(model: RecordingModel, response: Array) -> float:
    """1 − (after − floor)/(before − floor) with what the effects really add, known from the simulation, taken away.

    Parameters
    ----------
    model : the recording as the diagnosis linearises it
    response : (N,) what the effects add to the observations ζ, rad
    """
    reached = of_response(linear_model(model, (), rivals=False), model.whitened(response))
    return reached.closed if reached is not None else float("nan")
