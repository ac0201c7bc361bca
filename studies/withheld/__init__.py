"""The study `withheld`: is the diagnosis right about craft, gyros and effects, among them effects that it cannot name?

- `plans`: motions of spacecraft, rate tables and hands, their gyros and references
- `families`: effects that were never on the list
- `snr`: how strongly an effect shows to an analyst who does not know its waveform in the samples
- `listed`, `world`, `drawing`: the effects of the list that are drawn, what effects do to a plan, and the drawing of a case
- `judgement`: what an answer is worth
- `cases`: a case, its diagnosis, and its row; ``STUDY``
- `score`: scores, tables, figures and the comparison of two runs; ``ENTRY``
"""
