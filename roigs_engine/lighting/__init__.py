"""The light of a captured scene: panoramas in linear light, brightness of highlights."""
