"""A leader and its follower: footprints, walls, fields of cells, turning radii, chains."""
