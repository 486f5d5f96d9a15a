"""What the library asks of a robot."""
