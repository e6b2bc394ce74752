"""Pages that a command serves to the browser of this machine, and to nobody else."""

HOST = "127.0.0.1"
