"""What is done with a solution: write, compare, draw."""
