"""Bad inputs to every command, made by rules, and how each ends: ``python -m tests.corpus`` writes build/corpus."""
