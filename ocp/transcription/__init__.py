"""Transcription of continuous-time problems to sparse nonlinear programs."""
