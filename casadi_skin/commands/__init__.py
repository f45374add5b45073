"""The commands, one function each: parsed words in, exit status out."""
