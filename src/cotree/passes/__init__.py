"""Passes: one program to another with the same values, and a report of what each saved."""
