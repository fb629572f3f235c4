"""Generation of C text: nodes become expressions and statements, which templates arrange."""
