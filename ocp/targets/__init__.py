"""The state and the rows that goals lead to, without what bars and momentum keep already."""
