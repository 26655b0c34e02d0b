"""What the command line offers, as plain functions: the same names, the same arguments, the same JSON."""
