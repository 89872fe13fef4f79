"""Chains that join the packages, one file each; the command line ``tsgdd`` lists them."""
