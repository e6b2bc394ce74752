"""Truth: the row of labels, and finished datasets read as files. The instrument may not import this room."""
