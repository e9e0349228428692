"""YAML scenarios: loading, validation, and turning them into models."""
