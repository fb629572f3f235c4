"""From a program to somewhere else: C projects."""
