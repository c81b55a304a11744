"""Vector fields: critical points, sectors, flow lines, the dipole-like family."""
