"""Radio map, cleaning and matchers."""
