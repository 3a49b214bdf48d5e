"""Plans as data: replay, acceptance test, report, failure diagnosis."""
