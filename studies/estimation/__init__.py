"""Studies of attitude estimation: alignment, reference attitudes, the on-board form."""
