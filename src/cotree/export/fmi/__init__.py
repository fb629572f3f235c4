"""A model as a functional mock-up unit (FMU) of FMI 2 or 3.

In: a program after its passes. Out: one file with a model description, C sources that need nothing
but libm, and libraries for some platforms.
"""
