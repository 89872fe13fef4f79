"""What the scales hand to each other: Mandel map, stress measures, data sets, measured input, errors, files."""
