"""Options out of config files and the environment, for every command.

`configured` gives a command these options, `sources` knows where they come from, `layers` reads
what one source sets and chooses what holds, `values` turns it into what an option takes.
"""
