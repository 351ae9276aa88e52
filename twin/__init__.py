"""Twin: the discrete-event execution of a plan, and the `twin` command."""
