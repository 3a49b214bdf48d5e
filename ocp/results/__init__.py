"""Plans as data: their replay, their verdict, their report, and why there is none."""
