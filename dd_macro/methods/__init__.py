"""From a scene and a material to a solution: points, tangent spaces, Newton."""
