"""From photographs to reflectance parameters, pixel by pixel."""
