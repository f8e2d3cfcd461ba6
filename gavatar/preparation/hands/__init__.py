"""Hands in footage: where their 21 points are, and the fingers and wrists that follow."""
