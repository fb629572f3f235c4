"""Design optimisation: search for parameters that minimise an objective subject to constraints."""
