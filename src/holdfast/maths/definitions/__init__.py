"""What a user defines: systems, bounds, laws, measurements, regions, scenes, variation, units."""
