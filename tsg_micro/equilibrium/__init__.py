"""From loads to displacement: members, pressure, Newton, load path, linear solvers."""
