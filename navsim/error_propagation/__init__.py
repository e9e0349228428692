"""How errors of a landing become errors of its estimate, linearised along the truth."""
