"""Hamilton-Jacobi reachability: viability kernels, capture basins, reachable tubes."""
