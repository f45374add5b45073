"""What the commands do, a function a command: parsed words in, exit status out."""
