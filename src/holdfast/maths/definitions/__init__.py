"""User definitions: systems, bounds, laws, measurements, regions, scenes, variation, units."""
