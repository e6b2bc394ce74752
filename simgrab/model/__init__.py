"""The values that everything else is written in: scenarios, geometry, random streams, records, labels."""
