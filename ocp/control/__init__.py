"""Plans in closed loop: time-varying LQR and model predictive control."""
