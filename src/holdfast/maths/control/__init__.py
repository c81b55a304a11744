"""Feedback: barrier conditions, safety filters, blended redesign, tracking, observers, Lyapunov."""
