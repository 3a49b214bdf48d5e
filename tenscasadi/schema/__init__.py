"""Values that describe themselves: their fields, forms, checks and texts, and files made from them."""
