"""The boundary of a region: contingent cones, regulation maps, viability checks."""
