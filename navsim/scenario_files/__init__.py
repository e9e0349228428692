"""YAML files of scenarios: text with places, checked values, keys, presets, rewriting."""
