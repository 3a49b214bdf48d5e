"""Steps in time: schemes, step-size control, events, and what keeps bars and joints."""
