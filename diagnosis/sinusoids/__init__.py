"""Sinusoids in data that are cut into intervals: their spectrum, their fit, and one phase through all intervals.

- `spectrum`: mean periodograms of pieces, the level of the noise around each frequency, and the p-value of a line.
- `fit`: frequency, amplitudes and phases by Gauss and Newton, with a phase for each piece or one for all.
- `coherence`: the frequencies at which one phase over all intervals explains most, and their evidence.

The lines of the samples (`diagnosis.detectors.spectral_lines`) use the first two, the scan of periods
(`diagnosis.model.periods`) the third.
"""
