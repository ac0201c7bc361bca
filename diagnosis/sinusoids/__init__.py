"""Sinusoids in data that are cut into intervals: their spectrum, their fit, and one phase through all intervals.

- `spectrum`: mean periodograms of pieces, the level of the noise around each frequency, and the p-value of a line.
- `fit`: frequency, amplitudes and phases by Gauss and Newton, with a phase for each piece or one for all.
- `coherence`: the frequencies at which one phase over all intervals explains most, and their evidence.

The samples (`diagnosis.detectors.spectral_lines`), the references (`diagnosis.model.reference_tones`) and the scan of periods
(`diagnosis.model.periods`) use the same three.
"""
