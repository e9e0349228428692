"""The companion papers' systems: their worlds (circuit, mls, reports) and their filters (elevation, atc, azimuth)."""
