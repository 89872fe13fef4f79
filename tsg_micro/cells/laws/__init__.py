"""Member laws, one a file; what is registered here can be named in data sets and tissue files."""
