"""What is held and loaded: mesh, spaces, kinematics, supports, loads, linear solver; no data appear here."""
