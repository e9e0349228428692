"""Tables of publications, computed again: Table 2 of the source paper, levels of integrity."""
