"""A recording beside what scenarios give: where it stands in the distribution of their flights, and how far the gap closes."""
