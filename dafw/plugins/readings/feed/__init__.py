"""A live feed: its messages, the channels that bring them, the journal, and when a cycle has all of them."""
