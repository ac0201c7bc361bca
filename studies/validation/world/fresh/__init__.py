"""Effects outside the library, kinds of plans and grades, written without sight of the diagnosis."""
