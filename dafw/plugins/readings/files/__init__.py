"""Files of readings: CSV, netCDF and GeoJSON, all read into one kind of table."""
