"""Closed-loop control: tracking LQR, model predictive control, MPPI."""
