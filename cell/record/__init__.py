"""Recording of everything on the wire into MCAP files that standard tools open."""
