"""Reading CSV so that no field is lost: pandas drops, with a warning, what a row has beyond the header's names."""

import warnings
from pathlib import Path
from typing import Any

import pandas as pd


def read(path: Path, **options: Any) -> pd.DataFrame:
    """A table; a comma at the end of every row is let pass.

    Parameters
    ----------
    path : of the file
    options : of `pandas.read_csv`

    Raises
    ------
    ValueError
        A row has more fields than the header has names, or what else pandas has to say of a damaged file.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        warnings.simplefilter("ignore", pd.errors.DtypeWarning)  # who wants numbers sees that a column has none
        try:
            return pd.read_csv(path, index_col=False, **options)
        except pd.errors.ParserWarning:
            text = "a row has more fields than the header has names; is a comma the decimal sign, or a name missing?"
            raise ValueError(text) from None
