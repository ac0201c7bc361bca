"""Tables, figures and pages: what people read."""
