"""What happens on the boundary of a region: cones, regulation maps, viability checks."""
