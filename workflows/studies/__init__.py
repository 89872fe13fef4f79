"""One question each, asked of many runs; and their figures."""
