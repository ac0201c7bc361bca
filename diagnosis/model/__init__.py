"""Linear models: observations, nuisance columns and candidate columns, built from each kind of data."""
