"""Values that all rooms share: scenarios, geometry, random streams, records, labels."""
