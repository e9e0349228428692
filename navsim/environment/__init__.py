"""What surrounds a landing: satellites, transmitters, terrain, built from the scenario."""
