"""What start and goals say that the bars and momentum do not say already."""
