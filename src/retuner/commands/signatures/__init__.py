"""What can be typed of each command that loads much; its file in commands/ is loaded when it is called."""
