"""The commands of `ropeteam`, a module each: `add` gives a command its place in the parser.

A command imports what it needs when it runs: help and lists are there at once.
"""
