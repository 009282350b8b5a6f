"""What can be seen of a running session: on the terminal, and for the page that another process serves."""
