"""Hamilton-Jacobi reachability: viability kernels, reach-avoid sets (capture basins), tubes."""
