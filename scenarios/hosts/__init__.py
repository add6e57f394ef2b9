"""Robots of one run on several computers: machines that are offered, and a crew spread over them.

`machine` is what an offered computer does (`ropeteam host`), `crew` what the runner does with it,
`plans` how a robot's plan travels, `endpoints` where a router is and who one is there.
"""
