"""Where robots may go and in which order: cells, passages, routes, and the corners between."""
