"""Interval arithmetic from the same expressions: enclosures that count every rounding."""
