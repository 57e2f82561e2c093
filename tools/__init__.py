"""Benchmarks, fault campaigns, figures and a guest kernel for the package, which imports none of them."""
