"""The result: a plan, its replay, its report, and why there is none."""
