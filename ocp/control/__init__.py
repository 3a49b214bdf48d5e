"""Control in closed loop: LQR, model predictive control, sampling."""
