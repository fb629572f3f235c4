"""A model as a functional mock-up unit (FMU) of FMI 2 or 3, with C sources and libraries."""
