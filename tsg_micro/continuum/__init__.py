"""From displacement to stress: blocks, RVE, sampling, response, radial profiles, long waves."""
