"""Transcription of optimal control problems to sparse nonlinear programs."""
