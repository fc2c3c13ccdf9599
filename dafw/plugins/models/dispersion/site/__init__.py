"""The site: building footprints from a GeoJSON file, as a rectangle in metres with solid, well-separated buildings."""
