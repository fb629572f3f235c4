"""Generation of C text: nodes become expressions and statements, which fill templates."""
