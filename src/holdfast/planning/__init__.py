"""Motion planning of robot formations: cells, passages, routes, and corners between cells."""
