"""R reproduced: the Mission Mode loop flown through the flight's first five months, beside the flight's values."""
