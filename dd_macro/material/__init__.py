"""What answers a strain: metric, search, tangent spaces, laws; no mesh appears here."""
