"""Design optimisation: choice of parameters that minimise an objective subject to constraints."""
