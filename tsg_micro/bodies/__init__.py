"""Bodies that are loaded whole, with every bar and tendon."""
