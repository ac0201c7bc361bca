"""Raw sensor tables as a linear model: arcs of constant rate, columns of the sensors' effects, and their products."""
