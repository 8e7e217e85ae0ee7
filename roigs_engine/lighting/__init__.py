"""The light of a captured scene: panoramas in linear light, and how bright its highlights are."""
